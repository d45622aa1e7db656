-- Version 5. The table shapes has the small columns that are searched and listed. Everything that is read for single
-- shapes only is in further tables, by the number of the shape.
CREATE TABLE meta (
    key   TEXT PRIMARY KEY,         -- options (JSON), numbers_version, revision, label_revision
    value TEXT NOT NULL
);
CREATE TABLE shapes (
    number       INTEGER PRIMARY KEY,
    id           TEXT NOT NULL UNIQUE,
    path         TEXT NOT NULL UNIQUE,
    content_hash TEXT NOT NULL,
    label        TEXT,
    status       TEXT NOT NULL CHECK (status IN ('done', 'failed')),
    stage        TEXT,              -- where it failed
    error        TEXT,              -- how, by the name of the exception
    message      TEXT,              -- why, in words
    area         REAL,              -- of the first surface, unit length² of the shape
    n_vertices   INTEGER,           -- of the first surface, as the next two
    n_faces      INTEGER,
    euler        INTEGER,
    judgement    TEXT,              -- sound, doubtful or unusable; NULL: not judged
    uncertainty  REAL,              -- log-signature error that the checks let expect
    metres_per_unit REAL,           -- length of the unit of the area; NULL: unknown
    stamp        TEXT,              -- by which an unchanged file is known without reading it; NULL: unknown
    id_checksum     INTEGER,        -- CRC-32 of the id, the path and the label, and of all other columns of the
    path_checksum   INTEGER,        -- shape and its provenance except stamp
    label_checksum  INTEGER,
    record_checksum INTEGER
);
CREATE INDEX shapes_by_content ON shapes (content_hash);
CREATE INDEX shapes_by_status ON shapes (status, id);
CREATE INDEX doubtful_shapes ON shapes (id) WHERE judgement <> 'sound';
CREATE TABLE provenance (
    shape          INTEGER PRIMARY KEY,
    steps          TEXT NOT NULL,   -- JSON: stage, seconds, sizes, notes
    options_digest TEXT NOT NULL,
    versions       TEXT NOT NULL,   -- JSON
    added          TEXT NOT NULL,   -- UTC, ISO 8601
    reasons        TEXT             -- JSON: of the judgement; NULL: not judged
);
-- Signatures by the options of the catalogue (descriptor 0), and by other options.
CREATE TABLE descriptors (
    number INTEGER PRIMARY KEY,
    digest TEXT NOT NULL UNIQUE
);
CREATE TABLE signatures (
    descriptor INTEGER NOT NULL,
    shape      INTEGER NOT NULL,
    value      BLOB NOT NULL,       -- (L,) float64, little-endian, and a checksum
    PRIMARY KEY (descriptor, shape)
) WITHOUT ROWID;
-- Arrays of the s surfaces of a shape, as pcretrieve.catalogue.arrays packs them.
CREATE TABLE spectra (
    shape  INTEGER PRIMARY KEY,
    arrays BLOB NOT NULL            -- areas (s,), unit length² of the file; eigenvalues (s, k) of unit area
);
CREATE TABLE moments (
    shape  INTEGER PRIMARY KEY,
    arrays BLOB NOT NULL            -- (s, k, k) ⟨φ_i², φ_j⟩ of unit area
);
CREATE TABLE overlaps (
    shape  INTEGER PRIMARY KEY,
    arrays BLOB NOT NULL            -- (s, k, k) ⟨φ_i², φ_j²⟩ of unit area
);
CREATE TABLE meshes (
    shape  INTEGER PRIMARY KEY,
    arrays BLOB NOT NULL            -- vertices and faces of each surface in turn, unit length of the file
);
CREATE TABLE thumbnails (
    shape  INTEGER PRIMARY KEY,
    arrays BLOB NOT NULL            -- bytes of a PNG file: a picture of the first surface
);
