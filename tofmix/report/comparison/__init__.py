"""Two layers files of one size compared: numbers, table, pictures and page."""
