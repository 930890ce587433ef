"""Many ticks on an arm in one call: of a section model, or of a lumped film."""
