"""Bodies, joints, contacts and loads, and the equations of motion that follow from them."""
