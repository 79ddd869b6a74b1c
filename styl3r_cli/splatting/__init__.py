"""splatting"""
