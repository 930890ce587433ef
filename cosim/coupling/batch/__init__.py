"""Many ticks of a section model on an arm, in one call."""
