"""Discrete operators on a mesh: Warp kernels on the device, and sparse matrices."""

from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.launch import Launcher, find_device
from swe_sphere.operators.tendency import TendencyOperator

__all__ = ["DeviceMesh", "Launcher", "TendencyOperator", "find_device"]
