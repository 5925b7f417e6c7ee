"""The figures of the studies, one file each; they draw what they are given and compute nothing."""
