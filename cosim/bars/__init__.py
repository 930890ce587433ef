"""Error bars of a finished run."""
