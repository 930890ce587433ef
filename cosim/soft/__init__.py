"""The soft body: film, hinges, gas, cables, weight and contact, in statics and in implicit dynamics."""
