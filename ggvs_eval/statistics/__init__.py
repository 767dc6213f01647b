"""How sure a number is: variance over views and time, bootstrap intervals, paired comparisons, ties."""
