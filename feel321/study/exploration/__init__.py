"""Active exploration: the hand's motion drives how a stimulus is played."""
