"""What the documentation site is made of besides the pages in docs/: pages from registries, figures, formulas."""
