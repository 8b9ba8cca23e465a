"""Pictures: colours and themes, curves, images, and one module for each part of the page that draws."""
