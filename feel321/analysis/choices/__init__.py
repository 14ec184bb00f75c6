"""Choices between two stimuli: which metric predicts them, what they say of the stimuli, and how many are needed."""
