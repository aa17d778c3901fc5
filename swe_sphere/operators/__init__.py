"""Discrete operators on a mesh: on the device through Warp kernels, and as sparse matrices."""

from .device_mesh import DeviceMesh
from .launch import Launcher, find_device
from .tendency import TendencyOperator

__all__ = ["DeviceMesh", "Launcher", "TendencyOperator", "find_device"]
