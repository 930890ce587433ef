"""Reading of TOML tables into frozen dataclasses: types, rules, faults, overrides, suggestions."""
