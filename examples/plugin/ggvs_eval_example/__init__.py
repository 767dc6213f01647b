"""A metric, a method and a layout for ggvs-eval."""
