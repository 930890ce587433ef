"""Energy terms: films, hinges, gas, cables, stiff frames, weight."""
