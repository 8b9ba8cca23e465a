"""The interactive part of the page: Python packs the data, JavaScript unpacks and draws them."""
