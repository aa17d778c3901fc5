"""Scenes: each public function here that builds a `Scene` without arguments, in `SCENES`."""

from swe_sphere.testcases.user_scenes import SCENES, get_scene, list_scenes

__all__ = ["SCENES", "get_scene", "list_scenes"]
