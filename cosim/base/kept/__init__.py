"""What has been made and may serve again: in memory, and on disk."""
