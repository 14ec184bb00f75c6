"""Personal data in a study: where they are, withdrawal, separate storage, backups, and how long they are kept."""
