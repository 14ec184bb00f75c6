"""Speed against accuracy, stability where methods fail, and the least sufficient reducer."""
