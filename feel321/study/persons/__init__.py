"""What a study holds of the people who take part: where it is, who leaves, what is kept apart, copied, and due."""
