"""TOML to frozen records: bounded reading, overrides, types, suggestions."""
