"""A PostgreSQL server that is stopped, stands still, is full, or belongs to somebody who wishes no good."""

from __future__ import annotations

import logging
import os
import re
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
import shapes
from commands import program
from postgresql_server import Server, server_of_its_own
from processes import in_this_process
from stored import records
from test_rows import SETTINGS, done, failed, ids

import pcretrieve as pr
from pcretrieve.catalogue import postgresql as postgresql_module
from pcretrieve.catalogue.records import Record
from pcretrieve.catalogue.rows import Rows
from pcretrieve.errors import CatalogueError, InputError
from pcretrieve.formats import write_mesh

pytestmark = pytest.mark.slow

# Small closed meshes that are kept as they are, of which few numbers are computed.
OPTIONS: dict[str, dict[str, Any]] = {
    "surface": {"mode": "keep"},
    "spectral": {"n_pairs": 12},
    "signature": {"method": "shape-dna", "n_values": 5},
}

# The bytes with which a client ends a transaction, as a simple query or by a prepared statement.
COMMIT = b"COMMIT\0"


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """A server that tests stop and start."""
    with server_of_its_own() as started:
        yield started


@pytest.fixture
def schema() -> str:
    """The name of a schema that no other test has."""
    return f"away{uuid4().hex}"


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seconds in place of minutes."""
    monkeypatch.setattr(postgresql_module, "PATIENCE", 4.0)
    monkeypatch.setattr(postgresql_module, "SILENCE", 1.0)
    monkeypatch.setitem(postgresql_module.PARAMETERS, "connect_timeout", "2")


def created(url: str, schema: str) -> Rows:
    return Rows(
        f"{url}{'&' if '?' in url else '?'}schema={schema}", SETTINGS, create=True
    )


def connection_of(rows: Rows) -> Any:
    return rows.database._connection


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Those of pcretrieve; those of psycopg are not printed."""
    return [
        record.message
        for record in caplog.records
        if record.levelno >= logging.WARNING and record.name.startswith("pcretrieve")
    ]


# --- a server that is away ----------------------------------------------------------------------------


def test_an_ingest_goes_on_when_the_server_comes_back(
    server: Server, schema: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(6):
        write_mesh(
            shapes.ellipsoid((1, 1 + number / 10, 2), subdivisions=2),
            tmp_path / f"{number}.off",
        )
    timers = []

    def restart_after_two(record: Record) -> None:
        if record.id == "1":
            server.stop()
            timers.append(threading.Timer(3, server.start))
            timers[0].start()

    url = f"{server.url}?schema={schema}"
    summary = pr.ingest(
        tmp_path,
        url,
        options=OPTIONS,
        executor=in_this_process,
        on_shape=restart_after_two,
    )
    assert ids(summary.done) == [*"012345"]
    assert (
        len([text for text in warnings(caplog) if "is tried again for 300 s" in text])
        == 1
    )
    assert len(warnings(caplog)) == 1
    with pr.Catalogue(url) as catalogue:
        assert ids(catalogue.records()) == [*"012345"]
    found = pr.status(url)
    assert (found.state, found.n_done) == ("finished", 6)


def test_a_server_that_is_away_for_longer_is_an_error_with_advice(
    server: Server, schema: str, hurried: None, caplog: pytest.LogCaptureFixture
) -> None:
    with created(server.url, schema) as rows:
        rows.store(done("a"))
        server.stop()
        try:
            for _ in range(3):
                with pytest.raises(
                    CatalogueError, match="see to the server, and run the same"
                ):
                    rows.store(done("b"))
            assert len(warnings(caplog)) == 1
            with pytest.raises(CatalogueError, match=r"cannot be used: .*refused"):
                created(server.url, schema)
        finally:
            server.start()
        rows.store(done("b"))
        assert ids(records(rows)) == ["a", "b"]
        # The next time, the server is waited for again.
        server.stop()
        timer = threading.Timer(1, server.start)
        timer.start()
        assert ids(records(rows)) == ["a", "b"]
        timer.join()
        # But not by a server of pages.
        rows.answer_at_once()
        server.stop()
        try:
            started = time.monotonic()
            with pytest.raises(CatalogueError, match="see to the server"):
                records(rows)
            assert time.monotonic() - started < 1
        finally:
            server.start()


def test_a_server_that_starts_is_waited_for(server: Server, schema: str) -> None:
    """A server that recovers says so for some time."""
    created(server.url, schema).close()
    with socket.create_server(("127.0.0.1", 0)) as starting:

        def refuse_twice() -> None:
            fields = b"SFATAL\0VFATAL\0C57P03\0Mthe database system is starting up\0\0"
            for _ in range(2):
                client = starting.accept()[0]
                client.recv(1000)
                client.sendall(b"E" + (len(fields) + 4).to_bytes(4, "big") + fields)
                client.close()
            carry(starting.accept()[0], server.port)

        threading.Thread(target=refuse_twice, daemon=True).start()
        with created(
            f"{local(starting)}?sslmode=disable&gssencmode=disable", schema
        ) as rows:
            assert records(rows) == []


# --- transactions that are cut ------------------------------------------------------------------------


def local(listening: socket.socket) -> str:
    return f"postgresql://tester@127.0.0.1:{listening.getsockname()[1]}/postgres"


def carry(
    client: socket.socket,
    port: int,
    is_cut: Callable[[bytes], bool] = lambda data: False,
    is_delivered: Callable[[], bool] = lambda: False,
) -> None:
    """Carry bytes between a client and a server; cut both ways at some bytes, which may arrive still."""
    server = socket.create_connection(("127.0.0.1", port))
    for end in (client, server):
        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    cut = threading.Event()

    def carry_answers() -> None:
        with suppress(OSError):
            while (data := server.recv(1 << 16)) and not cut.is_set():
                client.sendall(data)

    threading.Thread(target=carry_answers, daemon=True).start()
    with suppress(OSError):
        while data := client.recv(1 << 16):
            if is_cut(data):
                cut.set()
                if is_delivered():
                    server.sendall(data)
                    time.sleep(0.05)
                break
            server.sendall(data)
    for end in (client, server):
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
        end.close()


class Once:
    """The first message that has some bytes."""

    def __init__(self, words: bytes) -> None:
        self._words = words
        self.is_over = False

    def __call__(self, number: int, data: bytes) -> bool:
        is_first = self._words in data and not self.is_over
        self.is_over = self.is_over or is_first
        return is_first


class Line:
    """A line to a server that is cut at a message of a client; the server may still get this message."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"{local(self._listening)}?sslmode=disable&gssencmode=disable"
        self.n_messages = 0
        self.cut_at: Callable[[int, bytes], bool] = lambda number, data: False
        self.is_delivered = False
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        self._listening.close()

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                client = self._listening.accept()[0]
                threading.Thread(target=self._carry, args=(client,), daemon=True).start()

    def _carry(self, client: socket.socket) -> None:
        def is_cut(data: bytes) -> bool:
            self.n_messages += 1
            return self.cut_at(self.n_messages, data)

        carry(client, self._server.port, is_cut, lambda: self.is_delivered)


@contextmanager
def line_to(server: Server) -> Iterator[Line]:
    with closing(Line(server)) as line:
        yield line


def is_message(number: int, count: int, data: bytes) -> bool:
    return count == number


OPERATIONS: dict[str, Callable[[Rows], object]] = {
    "store": lambda rows: rows.store(done("b", label="new")),
    "store a failure": lambda rows: rows.store(failed("f")),
    "add": lambda rows: rows.add([done("a", label="new"), done("g")]),
    "remove": lambda rows: rows.remove("a", "b"),
    "revise": lambda rows: rows.revise(
        moved={"/a.ply": "/z.ply"}, removed=["/b.ply"], labels={"/z.ply": "new"}
    ),
    "keep": lambda rows: rows.keep("new", [(done("a").record, b"12345678")]),
    "read": lambda rows: [
        rows.listed("own").ids,
        [one.record for one in rows.entries(["a", "b"])],
    ],
}


def state(rows: Rows) -> Any:
    with_entries = [
        (one.record, dict(one.signatures), dict(one.payloads))
        for one in rows.entries(ids(records(rows)))
    ]
    return with_entries, bytes(rows.listed("new").packed)


@pytest.mark.parametrize(
    "is_delivered", [False, True], ids=["request lost", "answer lost"]
)
@pytest.mark.parametrize("name", OPERATIONS)
def test_an_operation_that_is_cut_anywhere_happens_once(
    server: Server, name: str, is_delivered: bool, schema: str
) -> None:
    """Also if the answer to its COMMIT is lost, when only the server knows whether it was stored."""
    operation = OPERATIONS[name]
    start = [done("a"), done("b"), failed("e")]
    with created(server.url, f"{schema}x") as rows:
        rows.add(start)
        given = operation(rows)
        expected = state(rows)
    with line_to(server) as line, created(line.url, schema) as rows:
        is_over, number = False, 0
        while not is_over:
            number += 1
            rows.remove(*ids(records(rows)))
            rows.add(start)
            line.n_messages = 0
            line.is_delivered = is_delivered
            line.cut_at = partial(is_message, number)
            assert operation(rows) == given
            is_over = line.n_messages < number
            line.cut_at = lambda count, data: False
            assert state(rows) == expected
        assert number > 3
        # Not one transaction is left open.
        with pytest.raises(InputError):
            rows.remove("nobody")


def test_a_removal_whose_answer_is_lost_is_no_error(server: Server, schema: str) -> None:
    with line_to(server) as line:
        line.is_delivered = True
        with created(line.url, schema) as rows:
            rows.store(done("a"))
            line.cut_at = Once(COMMIT)
            rows.remove("a")
            assert line.cut_at.is_over
            assert records(rows) == []


def test_a_transaction_that_ends_its_connection_is_not_tried_for_ever(
    server: Server, schema: str, hurried: None, caplog: pytest.LogCaptureFixture
) -> None:
    with line_to(server) as line, created(line.url, schema) as rows:
        line.cut_at = lambda count, data: b"INSERT INTO provenance" in data
        started = time.monotonic()
        with pytest.raises(CatalogueError, match="see to the server"):
            rows.store(done("a"))
        assert time.monotonic() - started < 15
        assert len(warnings(caplog)) == 1
        line.cut_at = lambda count, data: False
        rows.store(done("a"))
        assert ids(records(rows)) == ["a"]


def test_a_session_that_is_ended_by_an_administrator_goes_on(
    server: Server, schema: str
) -> None:
    import psycopg

    with (
        created(server.url, schema) as rows,
        psycopg.connect(server.url, autocommit=True) as other,
    ):

        def end_it() -> None:
            session = connection_of(rows).info.backend_pid
            other.execute("SELECT pg_terminate_backend(%s)", [session])

        end_it()
        rows.store(done("a"))
        # While it waits for the lock.
        with psycopg.connect(server.url) as holding:
            holding.execute(f"SELECT value FROM {schema}.meta FOR UPDATE")

            def end_both() -> None:
                end_it()
                time.sleep(0.5)
                holding.rollback()

            timer = threading.Timer(0.5, end_both)
            timer.start()
            rows.store(done("b"))
            timer.join()
        assert ids(records(rows)) == ["a", "b"]


# --- a server that stands still -----------------------------------------------------------------------


@pytest.mark.parametrize("place", ["url", "socket_url"])
def test_a_server_that_stands_still_is_an_error_in_time(
    server: Server,
    schema: str,
    place: str,
    hurried: None,
    caplog: pytest.LogCaptureFixture,
) -> None:
    url = getattr(server, place)
    with created(url, schema) as rows:
        rows.store(done("a"))
        started = time.monotonic()
        with server.stands_still():
            with pytest.raises(
                CatalogueError, match="see to the server, and run the same"
            ):
                rows.store(done("b"))
            with pytest.raises(CatalogueError, match="timeout"):
                created(url, schema)
        assert time.monotonic() - started < 20
        assert (
            "the server has not answered for 1 s" in caplog.text
            or "timeout" in caplog.text
        )
        assert len(warnings(caplog)) == 1
        rows.store(done("b"))
        assert ids(records(rows)) == ["a", "b"]


def test_a_server_that_stands_still_for_a_while_loses_nothing(
    server: Server, schema: str, hurried: None
) -> None:
    with created(server.url, schema) as rows:
        for name in "abc":
            rows.store(done(name))
            still = server.stands_still()
            still.__enter__()
            timer = threading.Timer(2.5, still.__exit__, (None, None, None))
            timer.start()
            rows.remove(name)
            assert records(rows) == []
            timer.join()


def test_a_session_that_stands_still_is_given_up(
    server: Server, schema: str, hurried: None
) -> None:
    with created(server.url, schema) as rows:
        rows.store(done("a"))
        stopped = connection_of(rows).info.backend_pid
        os.kill(stopped, signal.SIGSTOP)
        try:
            rows.store(done("b"))
            assert ids(records(rows)) == ["a", "b"]
        finally:
            os.kill(stopped, signal.SIGCONT)


def test_time_limits_are_those_of_the_url_if_it_has_some(
    server: Server, schema: str
) -> None:
    for further, expected in (("", "10"), ("&connect_timeout=77", "77")):
        with created(f"{server.url}?sslmode=disable{further}", schema) as rows:
            known = connection_of(rows).info.get_parameters()
            assert known["connect_timeout"] == expected
            assert (known["keepalives_idle"], known["keepalives_count"]) == ("30", "3")
            assert (known["keepalives_interval"], known["tcp_user_timeout"]) == (
                "10",
                "60000",
            )


# --- settings of others -------------------------------------------------------------------------------


def test_settings_of_a_role_change_no_numbers_and_no_texts(
    server: Server, schema: str
) -> None:
    import psycopg

    entry = done("a", path="/Łódź 😀.ply", area=0.1 + 0.2)
    with psycopg.connect(server.url, autocommit=True) as admin:
        with created(server.url, schema) as rows:
            rows.store(entry)
        admin.execute("CREATE ROLE odd LOGIN SUPERUSER")
        settings = (
            "extra_float_digits = 0",
            "extra_float_digits = -15",
            "client_encoding = 'LATIN1'",
            "client_encoding = 'SQL_ASCII'",
            "bytea_output = 'escape'",
            "search_path = 'nothing'",
        )
        for setting in settings:
            admin.execute(f"ALTER ROLE odd SET {setting}")
            url = server.url.replace("tester", "odd")
            with created(url, schema) as rows:
                assert records(rows) == [entry.record], setting
                (found,) = rows.entries(["a"])
                assert (found.signatures, found.payloads) == (
                    entry.signatures,
                    entry.payloads,
                )
            admin.execute("ALTER ROLE odd RESET ALL")


# What the owner of a schema can do to its tables.
ACTING = {
    "trigger 'spy'": "CREATE TRIGGER spy BEFORE INSERT ON shapes EXECUTE FUNCTION theirs.spy()",
    "rule 'also'": "CREATE RULE also AS ON INSERT TO shapes DO ALSO INSERT INTO theirs.notes VALUES ('x')",
    "view 'descriptors'": "ALTER TABLE descriptors RENAME TO d; CREATE VIEW descriptors AS SELECT * FROM d",
    "view 'meta'": "ALTER TABLE meta RENAME TO m; CREATE VIEW meta AS SELECT * FROM m",
    "other relation 'arrays'": "DROP TABLE arrays; CREATE MATERIALIZED VIEW arrays AS SELECT 1",
    "policy 'watched'": "ALTER TABLE shapes ENABLE ROW LEVEL SECURITY; "
    "CREATE POLICY watched ON shapes USING (theirs.seen(id))",
    "default of table 'shapes'": "ALTER TABLE shapes ALTER label SET DEFAULT theirs.text_of('x')",
    "constraint 'checked'": "ALTER TABLE shapes ADD CONSTRAINT checked CHECK (theirs.seen(id))",
    "constraint 'linked'": "ALTER TABLE provenance ADD CONSTRAINT linked FOREIGN KEY (shape) "
    "REFERENCES shapes (number)",
    "column 'label'": "ALTER TABLE shapes ALTER label TYPE theirs.word",
    "child of table 'shapes'": "CREATE TABLE theirs.more () INHERITS (shapes)",
    "function of 'known'": "CREATE INDEX known ON shapes (theirs.text_of(id))",
    "function of 'few'": "CREATE INDEX few ON shapes (id) WHERE theirs.seen(id)",
    "function of 'ordered'": "CREATE INDEX ordered ON shapes (id theirs.order)",
}


@pytest.fixture(scope="module")
def others(server: Server) -> None:
    """Functions of somebody else."""
    import psycopg

    with psycopg.connect(server.url, autocommit=True) as owner:
        owner.execute(
            "CREATE SCHEMA theirs; CREATE TABLE theirs.notes (who text);"
            "CREATE FUNCTION theirs.spy() RETURNS trigger LANGUAGE plpgsql AS "
            "$$ BEGIN INSERT INTO theirs.notes VALUES (current_user); RETURN new; END $$;"
            "CREATE FUNCTION theirs.seen(text) RETURNS boolean IMMUTABLE LANGUAGE plpgsql AS "
            "$$ BEGIN RETURN true; END $$;"
            "CREATE FUNCTION theirs.text_of(text) RETURNS text IMMUTABLE LANGUAGE plpgsql AS "
            "$$ BEGIN RETURN $1; END $$;"
            "CREATE FUNCTION theirs.compared(text, text) RETURNS int IMMUTABLE LANGUAGE plpgsql AS "
            "$$ BEGIN RETURN bttextcmp($1, $2); END $$;"
            "CREATE OPERATOR CLASS theirs.order FOR TYPE text USING btree AS OPERATOR 1 <, "
            "OPERATOR 2 <=, OPERATOR 3 =, OPERATOR 4 >=, OPERATOR 5 >, FUNCTION 1 theirs.compared;"
            "CREATE DOMAIN theirs.word AS text CHECK (theirs.seen(value))"
        )


@pytest.mark.parametrize("what", ACTING)
def test_tables_that_act_are_refused(
    server: Server, others: None, schema: str, what: str
) -> None:
    import psycopg

    with created(server.url, schema) as rows:
        rows.store(failed("a"))
        with psycopg.connect(server.url, autocommit=True) as owner:
            owner.execute(f"SET search_path = {schema}")
            owner.execute(ACTING[what])
        said = rf"{schema} has the .*{re.escape(what)}.*, which no catalogue has, and which may act as"
        with pytest.raises(CatalogueError, match=said):
            created(server.url, schema)
        with pytest.raises(CatalogueError, match=said):
            pr.Catalogue(f"{server.url}?schema={schema}")
        # Also of who had it open before, and has to connect again.
        connection_of(rows).close()
        with pytest.raises(CatalogueError, match=said):
            records(rows)


def test_functions_of_the_schema_are_not_called(
    server: Server, others: None, schema: str
) -> None:
    """PostgreSQL prefers functions whose types match exactly to its own ones."""
    import psycopg

    created(server.url, schema).close()
    with psycopg.connect(server.url, autocommit=True) as owner:
        owner.execute(f"SET search_path = {schema}")
        for given in ("name, text", "text, name", "name, name"):
            owner.execute(
                f"CREATE FUNCTION has_schema_privilege({given}) RETURNS boolean LANGUAGE plpgsql AS "
                "$$ BEGIN RAISE 'called'; END $$"
            )
        for kind in ("smallint", "integer"):
            owner.execute(
                f"CREATE FUNCTION txid_status({kind}) RETURNS text LANGUAGE plpgsql AS "
                "$$ BEGIN RAISE 'called'; END $$"
            )
    with line_to(server) as line:
        line.is_delivered, line.cut_at = True, Once(COMMIT)
        with created(line.url, schema) as rows:
            assert rows.database.is_writable
            rows.store(done("a"))
            assert ids(records(rows)) == ["a"]
        assert line.cut_at.is_over


# --- a server that is full ----------------------------------------------------------------------------


def test_a_server_that_is_full_is_an_error_with_advice(
    server: Server, schema: str, hurried: None
) -> None:
    import psycopg

    said = r"as many connections as it allows: .*use fewer processes at a time, or raise"
    created(server.url, schema).close()
    with psycopg.connect(server.url, autocommit=True) as admin:
        admin.execute("CREATE ROLE few LOGIN CONNECTION LIMIT 1")
        few = server.url.replace("tester", "few")
        with psycopg.connect(few), pytest.raises(CatalogueError, match=said):
            created(few, schema)
        admin.execute("CREATE ROLE usual LOGIN")
        admin.execute(f"GRANT USAGE ON SCHEMA {schema} TO usual")
    usual = server.url.replace("tester", "usual")
    taken = []
    try:
        while True:
            taken.append(psycopg.connect(usual))
    except psycopg.OperationalError:
        with pytest.raises(
            CatalogueError, match=said
        ):  # the remaining ones are of superusers
            created(usual, schema)
    try:
        while True:
            taken.append(psycopg.connect(server.url))
    except psycopg.OperationalError:
        with pytest.raises(CatalogueError, match=said):
            created(server.url, schema)
        done_by = program("list", "-c", f"{server.url}?schema={schema}", code=1)
        assert done_by.stderr.count("\n") == 1
        assert re.search(said, done_by.stderr)
    finally:
        for connection in taken:
            connection.close()
