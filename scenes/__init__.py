"""What stands on the range: terrain, materials and spectra, panels, frustum targets, layout (6.2.3), sun and sky.

Plain data and meshes in the world frame; nothing here renders.

Modules
-------
model     the data classes
spectra   materials and their spectra from 400 to 1700 nm
terrain   ground with slope, relief and texture
panels    reflectance panels (6.2.2 a-b)
frustums  geometric targets (6.2.2 c-g)
layout    where they stand (6.2.3)
sunsky    position and spectrum of sun and sky
build     Config -> Scene
"""
