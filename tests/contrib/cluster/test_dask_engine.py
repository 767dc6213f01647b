"""The cluster of dask that a run starts on its own machine."""

import urllib.error
import urllib.request

import pytest

from ggvs_eval.contrib.cluster import dask_engine


def listening() -> list[tuple[str, int]]:
    """Addresses and ports at which this process and its children listen."""
    psutil = pytest.importorskip("psutil")
    here = psutil.Process()
    sockets = [
        each
        for process in (here, *here.children(recursive=True))
        for each in process.net_connections("inet")
    ]
    return [tuple(each.laddr) for each in sockets if each.status == psutil.CONN_LISTEN]


@pytest.mark.slow
def test_a_local_cluster_obeys_its_own_process_alone():
    """Every port that it opens is of this machine, wants our certificate or answers nothing; none
    is dask's well-known one.
    """
    distributed = pytest.importorskip("distributed")
    pytest.importorskip("cryptography")
    before = listening()
    with (
        dask_engine._local_cluster(distributed, 2) as cluster,
        distributed.Client(cluster) as client,
    ):
        assert client.submit(abs, -2).result() == 2
        ports = [each for each in listening() if each not in before]
        assert len(ports) >= 3  # scheduler and workers
        for host, port in ports:
            assert host == "127.0.0.1"
            assert port != 8787
            for path in ("", "health", "metrics", "info/main/workers.html", "json/identity.json"):
                with pytest.raises((urllib.error.HTTPError, ConnectionError)) as refused:
                    urllib.request.urlopen(f"http://{host}:{port}/{path}", timeout=20)
                assert (
                    not isinstance(refused.value, urllib.error.HTTPError)
                    or refused.value.code == 404
                )
        plain = cluster.scheduler_address.replace("tls", "tcp")
        for address, security in (
            (plain, None),
            (cluster.scheduler_address, distributed.Security.temporary()),
        ):
            with pytest.raises((OSError, RuntimeError)):
                distributed.Client(address, security=security, timeout=2)
