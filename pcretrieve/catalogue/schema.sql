-- One row a shape. Arrays are .npz archives; nothing in here is executable.
CREATE TABLE IF NOT EXISTS meta (
    key   TEXT PRIMARY KEY,
    value TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS shapes (
    id             TEXT PRIMARY KEY,
    path           TEXT NOT NULL UNIQUE,
    content_hash   TEXT NOT NULL,
    label          TEXT,
    status         TEXT NOT NULL CHECK (status IN ('done', 'failed')),
    stage          TEXT,            -- where it failed
    error          TEXT,            -- how, by the name of the exception
    message        TEXT,            -- why, in words
    steps          TEXT NOT NULL,   -- provenance, JSON: stage, seconds, sizes, notes
    area           REAL,            -- unit length² of the file
    n_vertices     INTEGER,
    n_faces        INTEGER,
    euler          INTEGER,
    eigenvalues    BLOB,            -- (s, k) of each of its surfaces at unit area, and surface_areas (s,)
    moments        BLOB,            -- (s, k, k) ⟨φ_i², φ_j⟩ of the same, and overlaps ⟨φ_i², φ_j²⟩
    signature      BLOB,            -- (L,) by the options of this catalogue
    mesh           BLOB,            -- vertices and faces, vertices1 and faces1, … of its surfaces, unit of the file
    options_digest TEXT NOT NULL,
    versions       TEXT NOT NULL,   -- JSON
    added          TEXT NOT NULL    -- UTC, ISO 8601
);
CREATE INDEX IF NOT EXISTS shapes_by_content ON shapes (content_hash);
CREATE TABLE IF NOT EXISTS whitenings (
    digest      TEXT PRIMARY KEY,
    kind        TEXT NOT NULL,
    fingerprint TEXT NOT NULL,      -- of the signatures and labels that it was fitted on
    arrays      BLOB NOT NULL
);
