"""ENeRF (Lin et al. 2022): cost volumes find the surface, a few samples around it blend the views' colours."""
