"""Scenes: every function of these modules that returns a `Scene`, by name in `SCENES`."""

from swe_sphere.testcases.user_scenes import SCENES, get_scene, list_scenes

__all__ = ["SCENES", "get_scene", "list_scenes"]
