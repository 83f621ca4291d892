"""What stands on the range: terrain, materials and spectra, panels, frustum targets, layout (6.2.3), sun and sky.

Plain data and meshes in the world frame; nothing here renders.

Modules
-------
model     the data classes
spectra   materials and their spectra from 400 to 1700 nm
streams   named random streams
shapes    triangulated bodies: boxes, rings, placement
terrain   ground with slope and relief
panels    reflectance panels (6.2.2 a-b)
frustums  geometric targets (6.2.2 c-g)
fields    what both sensors see on every heading (6.2.3)
layout    where targets stand in it (6.2.3)
sunsky    position and spectrum of sun and sky
build     Config -> Scene
"""
