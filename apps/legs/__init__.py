"""Legs of training, for `train_leg.py`: so many minutes, cut into phases that may travel."""
