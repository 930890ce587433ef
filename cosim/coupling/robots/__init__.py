"""Models of the soft robot on the flange: film, reduced beam model, frozen shape."""
