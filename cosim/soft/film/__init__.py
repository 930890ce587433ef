"""The potential of a film with gradient and tangent, as sums of kernels."""
