"""Keys of an IMU, a scene and a protocol: the page that users read has what the code has, and what
the code has is what files that say less are completed with."""

from dataclasses import asdict

import keys
import pytest
from omegaconf import OmegaConf

from lbgc.commands import as_written
from lbgc.sensor.datasheet import GyroConfig, ImuConfig


def test_the_page_of_all_keys_is_what_the_dataclasses_say():
    assert keys.PAGE.read_text() == keys.page(), "the page is behind the code: make keys"


def test_a_list_of_defaults_that_is_brought_along_may_name_them(cli, tmp_path):
    """As ours do. What it leaves out is as the dataclass has it, spelled as in YAML."""
    (tmp_path / "mine/imu").mkdir(parents=True)
    text = "defaults: [/imu_defaults@_global_.imu, _self_]\ngyro: {arw_deg_per_sqrt_h: 0.3}"
    (tmp_path / "mine/imu/bare.yaml").write_text(text)
    done = cli("lbgc.bound", "--config-dir", "mine", "imu=bare", "--cfg", "job")
    imu = OmegaConf.create(done.out).imu
    expected = as_written(asdict(ImuConfig(gyro=GyroConfig(arw_deg_per_sqrt_h=0.3))))
    assert OmegaConf.to_container(imu) == expected


@pytest.mark.parametrize("name", ["imu_defaults", "protocol_defaults"])
def test_what_the_program_composes_itself_cannot_be_brought_along(cli, tmp_path, name):
    (tmp_path / f"{name}.yaml").write_text("name: mine")
    done = cli("lbgc.bound", "--config-dir", str(tmp_path), "imu=ideal", "--cfg", "job")
    assert done.code == 0
    assert "mine" not in done.out
