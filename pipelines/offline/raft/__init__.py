"""RAFT-Stereo (Lipson, Teed, Deng 2021): the network in its published configurations and a compact one of ours."""
