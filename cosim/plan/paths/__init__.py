"""Motions of the flange and of the joints through phases, and along paths of the tip."""
