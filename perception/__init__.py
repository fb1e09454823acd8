"""VLAD-Grasp: a model imagines a rod through the object; geometry derives grasps from it. No training.

Frames and units: docs/frames.md.
"""
