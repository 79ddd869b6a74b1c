"""Other precisions of graphs that are exported already: numpy, onnx and onnxruntime, no torch."""
