"""Reading files for people: numbers (`summary`, `pixels`), pictures (`figures`), and HTML pages on `templates`."""
