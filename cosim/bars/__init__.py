"""Error bars: how far the figures of a finished run may be off."""
