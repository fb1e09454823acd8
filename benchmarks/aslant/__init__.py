"""One RGB-D image, taken from above or aslant, through `vlad_cell.detect`: are its grasps true, how deep, how sure?"""
