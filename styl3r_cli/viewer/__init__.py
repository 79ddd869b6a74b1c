"""The interactive viewer: a page of viser's, with the scene as viser takes it."""
