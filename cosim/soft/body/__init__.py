"""The soft body as one: its chambers, centre line, attachments and copies."""
