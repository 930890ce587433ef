"""Which modules hold the kernels of the contact query, for compilation ahead of a run."""

from __future__ import annotations

from types import ModuleType

from cosim.rigid.distance import features, mesh_distance, signed_distance

KERNEL_MODULES: tuple[ModuleType, ...] = (features, mesh_distance, signed_distance)
