"""How sure a number is: variance over views and time, intervals, paired comparisons, ties."""
