"""How good a model is on real photos, beside baselines: `python -m styl3r_export.evaluate`."""
