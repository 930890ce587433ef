"""What happens: carriers, parts and the loop over ticks or increments."""
