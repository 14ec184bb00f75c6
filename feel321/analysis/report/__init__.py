"""The report: sections, words, figures' captions, page and files."""
