"""Discrete operators on a mesh: on the device through Warp kernels, and as sparse matrices."""

from .device_mesh import DeviceMesh
from .launch import Launcher, find_device
from .pointwise import PointwiseOperator
from .tendency import TendencyOperator

__all__ = ["DeviceMesh", "Launcher", "PointwiseOperator", "TendencyOperator", "find_device"]
