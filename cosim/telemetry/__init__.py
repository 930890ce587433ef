"""What is seen of a run: snapshots, decisions, figures and the summary."""
