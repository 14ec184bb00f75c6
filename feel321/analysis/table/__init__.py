"""Tables in: read strictly, checked, joined to their stimuli; or one clear line about what is wrong."""
