"""Scenes: each is a short function of data and formulas, found by its module."""

from swe_sphere.testcases.user_scenes import SCENES, get_scene, list_scenes

__all__ = ["SCENES", "get_scene", "list_scenes"]
