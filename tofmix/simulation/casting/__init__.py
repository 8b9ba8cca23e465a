"""What each pixel sees of a scene: by beams for recordings, by exact areas for predictions."""
