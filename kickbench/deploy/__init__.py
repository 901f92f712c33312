"""Policies outside of kickbench: an ONNX file and the contract that says what goes in and comes out."""
