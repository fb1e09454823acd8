"""Several views of one scene: their points averaged, the camera's mounting corrected, the table told from the mounting.

Points are in ``base``; a correction of the mounting is one of the colour camera's frame, ``color``, the same for every
view (docs/frames.md).
"""
