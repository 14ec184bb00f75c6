"""Tables in: read strictly, checked, married to their stimuli; or one clear line about what is wrong."""
