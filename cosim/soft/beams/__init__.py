"""Stiffeners as rings of beams: `beam_rings` is the element, the other files what it is made of."""
