-- Version 5: what schema.sql has, in a schema of a PostgreSQL database. Texts are compared by code point, as in Python
-- and in SQLite (the collation "C").
CREATE TABLE meta (
    key   text PRIMARY KEY,         -- options (JSON), numbers_version, schema_version, revision, label_revision
    value text NOT NULL
);
CREATE TABLE shapes (
    number       bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    id           text COLLATE "C" NOT NULL UNIQUE,
    path         text COLLATE "C" NOT NULL,
    content_hash text COLLATE "C" NOT NULL,
    label        text COLLATE "C",
    status       text COLLATE "C" NOT NULL CHECK (status IN ('done', 'failed')),
    stage        text,
    error        text,
    message      text,
    area         double precision,
    n_vertices   bigint,
    n_faces      bigint,
    euler        bigint,
    judgement    text,
    uncertainty  double precision,
    metres_per_unit double precision,
    stamp        text,
    id_checksum     bigint,
    path_checksum   bigint,
    label_checksum  bigint,
    record_checksum bigint
);
-- By a hash, because an entry of an index must be shorter than a path may be.
CREATE UNIQUE INDEX shapes_by_path ON shapes (md5(path));
CREATE INDEX shapes_by_content ON shapes (content_hash);
CREATE INDEX shapes_by_status ON shapes (status, id);
CREATE INDEX doubtful_shapes ON shapes (id) WHERE judgement <> 'sound';
CREATE TABLE provenance (
    shape          bigint PRIMARY KEY REFERENCES shapes ON DELETE CASCADE,
    steps          text NOT NULL,
    options_digest text NOT NULL,
    versions       text NOT NULL,
    added          text NOT NULL,
    reasons        text
);
CREATE TABLE signatures (
    digest text COLLATE "C" NOT NULL,
    shape  bigint NOT NULL REFERENCES shapes ON DELETE CASCADE,
    value  bytea NOT NULL,
    PRIMARY KEY (digest, shape)
);
CREATE INDEX signatures_by_shape ON signatures (shape);
CREATE TABLE payloads (
    shape  bigint NOT NULL REFERENCES shapes ON DELETE CASCADE,
    name   text COLLATE "C" NOT NULL,   -- spectra, moments, overlaps, meshes or thumbnails
    arrays bytea NOT NULL,
    PRIMARY KEY (shape, name)
);
-- The arrays are compressed already.
ALTER TABLE payloads ALTER COLUMN arrays SET STORAGE EXTERNAL;
