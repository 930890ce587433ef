"""What every room uses: arrays, rotations and frames, kernels, frozen records, files, saved states."""
