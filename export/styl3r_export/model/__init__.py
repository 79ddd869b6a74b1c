"""The network: one configuration dataclass, one module, `build`."""

from styl3r_export.model.config import CONFIGS, FULL, MINI, ModelConfig
from styl3r_export.model.network import StructureOutput, Styl3r, build

__all__ = ["CONFIGS", "FULL", "MINI", "ModelConfig", "StructureOutput", "Styl3r", "build"]
