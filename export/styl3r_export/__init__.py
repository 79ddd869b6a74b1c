"""What makes the graphs: the network in torch, its training, checkpoints and ONNX export."""
