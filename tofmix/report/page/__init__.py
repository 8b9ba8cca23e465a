"""The report as one HTML page, and the templates and styles that all pages share."""
