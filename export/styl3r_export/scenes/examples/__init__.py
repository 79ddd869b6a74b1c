"""The example room's photographs and the example style pictures, all made by this project."""
