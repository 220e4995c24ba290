"""Measurement of a spectrum with a generator, an oscilloscope and a resistor.

    setup = read_bench(Path("BENCH.toml"))            # setup
    run = measure(setup, Path("RUN.h5"))              # sweep: each point is on disk before the next
    compensation = read_compensation(setup.standards) # spectra: open, short and load
    level_spectra(run, setup, compensation)[0]        # spectra: the Spectrum, its uncertainty, its flags

A point is two waveforms (sine_fit), their ratio and the resistor (impedance), and the correction for the cable by open,
short and load (compensation). `waveforms` reads waveforms that were saved by hand.
"""
