"""How equilibria depend on a robot's values, and which values measured curves have."""
