"""Arms by name and by file: `arm.toml`, and URDF reduced to the chain from the root to the flange."""
