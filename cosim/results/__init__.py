"""What a run saw: arrays in memory and on disk, tables, pictures."""
