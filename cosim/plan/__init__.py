"""What a scenario asks for: the flange's way, joint paths, loads, targets of the tip."""
