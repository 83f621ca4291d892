"""The contract between those who fly and those who evaluate: configuration models and the campaign folder.

Words only: names, units, file formats. No formula of the standard and no frame mathematics lives here, so that the
simulator and the evaluator share nothing that could cancel out.

Modules
-------
errors       the one-line errors every package raises
config       models of a campaign configuration (TOML) and of device files
load         reads a configuration: devices by name, overrides, errors that name the nearest setting
folder       where each file of a campaign folder stands
survey       surveyed targets, ground control list, spectra
sensors      data sheets, nominal mounting, calibration certificate
manifest     manifest.json and checksums
truth        what only a simulated campaign knows; the evaluator opens it in `score` alone
flight/      of each sortie: LAS with waveform packets, TIFF with EXIF and XMP, SBET, plan, exposures, environment, observations
benches/     of sphere and chessboard, and of the ranging line: logs, pictures, readings, scans
checks/      every problem of a folder at once
archive/     the archive of 10.3
writing/     files and folders that appear complete or not at all, and go on where they were stopped
formats/     bytes and text below all of these
"""
