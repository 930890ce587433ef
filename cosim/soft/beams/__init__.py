"""Stiffeners as rings of beams: `beam_rings` is the element, `beam` and `ring_kernels` its kernels."""
