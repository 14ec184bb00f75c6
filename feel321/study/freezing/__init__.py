"""What a study decides before its ratings are seen: written down, shown as text, and compared with what was done."""
