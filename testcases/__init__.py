"""The scenes: one short function each, of data and formulas, found where it is defined."""

from swe_sphere.testcases.user_scenes import SCENES, get_scene, list_scenes

__all__ = ["SCENES", "get_scene", "list_scenes"]
