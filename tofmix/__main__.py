"""``python -m tofmix`` is the command ``tofmix``."""

from tofmix.cli.start import run

if __name__ == "__main__":
    run()
