"""Chains of rigid frames, one per ring; the sections between them carry the condensed energy of the film."""
