"""How both sides are brought to agree: staggered, iterated, or by what the masses ask for."""
