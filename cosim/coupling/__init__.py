"""The exchange between the rigid and the soft side, tick by tick."""
