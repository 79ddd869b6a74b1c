"""How good a model is, beside baselines: `python -m styl3r_export.evaluate`."""
