"""What vibrates: the rig, what is played on it, and what protects skin and coil."""
