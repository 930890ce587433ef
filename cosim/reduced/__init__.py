"""Section models, the second soft model: chains of rigid frames with energies condensed from the film."""
