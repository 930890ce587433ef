"""The rigid scene as it moves: state, servos, contacts, added inertia."""
