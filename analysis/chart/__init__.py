"""Speed against accuracy of every reducer."""
