"""The path of light: which way pixels look, by projection and lens.

Nothing here knows recordings or layers; of the other modules it takes the names of array types alone.
"""
