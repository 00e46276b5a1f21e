"""Scene files: TOML that describes a scene, validated field by field."""

from pftwin.files.scene_file.loading import LoadedScene, load_scene, load_scene_file

__all__ = ["LoadedScene", "load_scene", "load_scene_file"]
