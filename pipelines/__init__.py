"""From a capture to numbers: the offline half, the online half, and the run itself."""
