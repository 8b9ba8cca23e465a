"""Which effects are added to a model: each is fitted and scored, added and dropped, and sets of them are compared."""
