"""Reading a layers file for people: numbers (`summary`, `tables`) and pictures (`page`)."""
