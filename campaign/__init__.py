"""The contract between those who fly and those who evaluate: configuration models and the campaign folder.

Words only: names, units, file formats. No formula of the standard and no frame mathematics lives here, so that the
simulator and the evaluator share nothing that could cancel out.

Modules
-------
errors       the one-line errors every package raises
config       models of a campaign configuration (TOML) and of device files
load         reads a configuration: devices by name, overrides, errors that name the nearest setting
folder       where each file of a campaign folder stands
las          LAS 1.4 point records with waveform packets (.wdp)
images       16-bit TIFF with EXIF and XMP, JPEG preview
trajectory   SBET, smrmsg and CSV
survey       surveyed targets, ground control list, spectra
sensors      data sheets, nominal mounting, calibration certificate
records      flight plan, exposures, environment, observations
manifest     manifest.json and checksums
truth        what only a simulated campaign knows; the evaluator opens it in `score` alone
check        every problem of a folder or configuration at once
atomic       files and folders that appear complete or not at all
formats/     bytes and text below all of these
"""
