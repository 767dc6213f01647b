"""IterMVS: depth of a camera from several calibrated partners at once, by the published network."""
