"""Training of the networks: procedural corpus with exact ground truth, optimisers, loop."""
