"""Advice for a program that has an image of its own, and neither a cell nor a report, when no grasp is found."""

from __future__ import annotations

from bus.codes import Code

FOR_AN_IMAGE: dict[Code, str] = {
    Code.NO_OBJECT: "Is the object inside region_m, and in the picture? What is lower than"
    " perception.min_object_height_m is none.",
    Code.TARGET_NOT_FOUND: "Name it differently in settings, as perception.target.text, pixel, box or point_m.",
    Code.OBSTRUCTED: "Ask for what lies on it first, or take it away.",
    Code.NOT_SEEN: "Is all of region_m in the picture, and is there depth? Look from above, from another side, or"
    " lower perception.min_table_seen.",
    Code.NO_TABLE: "Correct base_from_camera, so that the table is the plane z = 0 of base; or give the table its"
    " height in settings: scene.table.center_m, whose z is half of scene.table.size_m below the top.",
    Code.TABLE_MOVED: "Correct base_from_camera, or give the table its height in settings: scene.table.center_m, whose"
    " z is half of scene.table.size_m below the top. Tolerated are scene.table.tolerance_mm and tolerance_deg.",
    Code.TOO_NEAR: "Look from farther away, so that the table is seen around the object.",
    Code.NO_DEPTH: "The camera cannot measure glass, black and shiny things, nor what is too near: take it out, dull"
    " it, or look from farther away. What is nearer than camera.least_range_m does not count.",
    Code.MODEL_REFUSED: "Rephrase the target in settings, or use another model.",
    Code.MODEL_NO_IMAGE: "The model answered in words where a picture was due: try again, or use another model.",
    Code.MODEL_NO_ROD: "The goal image holds no rod: try again, or raise perception.imagine.samples.",
}
"""Other than `bus.codes.ADVICE`, which is for who operates a cell."""
