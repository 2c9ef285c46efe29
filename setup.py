"""What pyproject.toml cannot say: `pip install -e` leaves sim/ and conf/ beside lbgc/, where the
checkout has them. A module has one name: in lbgc.sim in a wheel, in sim here."""

from setuptools import setup
from setuptools.command.editable_wheel import editable_wheel


class Checkout(editable_wheel):
    def finalize_options(self) -> None:
        self.distribution.packages, self.distribution.package_dir = ["lbgc", "sim"], {}
        super().finalize_options()


setup(cmdclass={"editable_wheel": Checkout})
