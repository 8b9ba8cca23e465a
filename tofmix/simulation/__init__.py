"""Synthetic recordings: scene (model, cast) -> sensor (events, averaging) -> recording (render).

Use it to make samples whose truth is known. Nothing here estimates, and nothing
here reads or writes files. The effects of the contract (``[[effect]]``) are not
here yet; a model that lists one is refused.
"""
