"""Recordings in Rerun's viewer, in pictures and in videos."""
