"""Speed against accuracy of every reducer: measured in one run, compared, drawn, explored."""
