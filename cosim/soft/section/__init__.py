"""Chains of rigid frames, one per ring, whose sections carry the energy condensed from the film between them."""
