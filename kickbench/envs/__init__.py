"""Terms, named by YAML; initial states; one step of many envs, and that step as a CUDA graph."""
