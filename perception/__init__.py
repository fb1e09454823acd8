"""VLAD-Grasp: a model imagines a rod through the object; geometry carries it back and makes grasps. No training."""
