-- The first schema of the service. PostgreSQL 15 or newer; a test compares it with the models.

CREATE TABLE audit_log (
    id BIGINT GENERATED ALWAYS AS IDENTITY,
    at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    actor TEXT NOT NULL,
    action TEXT NOT NULL,
    subject TEXT NOT NULL,
    before JSONB,
    after JSONB NOT NULL,
    CONSTRAINT pk_audit_log PRIMARY KEY (id)
);
CREATE INDEX ix_audit_log_at ON audit_log (at);
CREATE TABLE board_changes (
    id BIGINT GENERATED ALWAYS AS IDENTITY,
    mark BIGINT NOT NULL,
    CONSTRAINT pk_board_changes PRIMARY KEY (id)
);
CREATE TABLE competition (
    name TEXT NOT NULL,
    definition JSONB NOT NULL,
    applied_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    frozen_at TIMESTAMP WITH TIME ZONE,
    finalized_at TIMESTAMP WITH TIME ZONE,
    winners JSONB,
    boards JSONB,
    reopened JSONB DEFAULT '[]' NOT NULL,
    CONSTRAINT pk_competition PRIMARY KEY (name),
    CONSTRAINT ck_competition_has_a_name CHECK (name <> ''),
    CONSTRAINT ck_competition_final_has_winners CHECK ((finalized_at IS NULL) = (winners IS NULL)),
    CONSTRAINT ck_competition_only_final_has_boards CHECK (boards IS NULL OR finalized_at IS NOT NULL)
);
CREATE TABLE cosignatures (
    witness TEXT NOT NULL,
    size BIGINT NOT NULL,
    signature BYTEA NOT NULL,
    signed_at TIMESTAMP WITH TIME ZONE NOT NULL,
    CONSTRAINT pk_cosignatures PRIMARY KEY (witness, size)
);
CREATE TABLE declared_evaluators (
    track TEXT NOT NULL,
    version TEXT NOT NULL,
    outdated VARCHAR(16) DEFAULT 'restart' NOT NULL,
    CONSTRAINT pk_declared_evaluators PRIMARY KEY (track),
    CONSTRAINT ck_declared_evaluators_outdated CHECK (outdated IN ('restart', 'finish'))
);
CREATE TABLE metric_totals (
    name TEXT NOT NULL,
    labels TEXT NOT NULL,
    value FLOAT NOT NULL,
    CONSTRAINT pk_metric_totals PRIMARY KEY (name, labels)
);
CREATE TABLE receipt_key (
    id INTEGER DEFAULT 1 NOT NULL,
    private_key VARCHAR(64) NOT NULL,
    public_key VARCHAR(64) NOT NULL,
    made_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_receipt_key PRIMARY KEY (id),
    CONSTRAINT ck_receipt_key_is_the_only_one CHECK (id = 1),
    CONSTRAINT ck_receipt_key_private_key_is_hexadecimal CHECK (private_key ~ '^[0-9a-f]{64}$')
);
CREATE TABLE rejudgements (
    id UUID NOT NULL,
    competition TEXT DEFAULT '' NOT NULL,
    track TEXT NOT NULL,
    stage TEXT NOT NULL,
    reason TEXT NOT NULL,
    started_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    applied_at TIMESTAMP WITH TIME ZONE,
    discarded_at TIMESTAMP WITH TIME ZONE,
    CONSTRAINT pk_rejudgements PRIMARY KEY (id),
    CONSTRAINT ck_rejudgements_ends_in_one_way CHECK (applied_at IS NULL OR discarded_at IS NULL)
);
CREATE TABLE schema_compatibility (
    oldest TEXT NOT NULL,
    CONSTRAINT pk_schema_compatibility PRIMARY KEY (oldest)
);
CREATE TABLE sealed_lists (
    commitment VARCHAR(64) NOT NULL,
    competition TEXT NOT NULL,
    track TEXT NOT NULL,
    stage TEXT NOT NULL,
    secret VARCHAR(64) NOT NULL,
    made_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    revealed_at TIMESTAMP WITH TIME ZONE,
    withdrawn_at TIMESTAMP WITH TIME ZONE,
    played_at TIMESTAMP WITH TIME ZONE,
    CONSTRAINT pk_sealed_lists PRIMARY KEY (commitment),
    CONSTRAINT uq_sealed_lists_competition_track_stage UNIQUE (competition, track, stage),
    CONSTRAINT ck_sealed_lists_commitment_is_sha256 CHECK (commitment ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_sealed_lists_secret_is_hexadecimal CHECK (secret ~ '^[0-9a-f]{64}$')
);
CREATE TABLE stations (
    name TEXT NOT NULL,
    key_sha256 TEXT NOT NULL,
    worker_id UUID,
    twin TEXT,
    created_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_stations PRIMARY KEY (name),
    CONSTRAINT uq_stations_key_sha256 UNIQUE (key_sha256)
);
CREATE TABLE live_pictures (
    station TEXT NOT NULL,
    taken_at TIMESTAMP WITH TIME ZONE DEFAULT clock_timestamp() NOT NULL,
    competition TEXT NOT NULL,
    track TEXT NOT NULL,
    stage TEXT NOT NULL,
    picture BYTEA NOT NULL,
    CONSTRAINT pk_live_pictures PRIMARY KEY (station, taken_at),
    CONSTRAINT fk_live_pictures_station FOREIGN KEY(station) REFERENCES stations (name) ON DELETE CASCADE
);
CREATE TABLE teams (
    id UUID NOT NULL,
    name VARCHAR(64) NOT NULL,
    name_key VARCHAR(64) NOT NULL,
    contact VARCHAR(254),
    created_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    disqualified_at TIMESTAMP WITH TIME ZONE,
    disqualified_for TEXT,
    approved_at TIMESTAMP WITH TIME ZONE,
    refused_for TEXT,
    named_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    erased_at TIMESTAMP WITH TIME ZONE,
    pseudonym VARCHAR(64) DEFAULT ('Team '::text || upper(substr(md5((gen_random_uuid())::text), 1, 10))) NOT NULL,
    note TEXT DEFAULT '' NOT NULL,
    CONSTRAINT pk_teams PRIMARY KEY (id),
    CONSTRAINT ck_teams_disqualified_for_a_reason CHECK ((disqualified_at IS NULL) = (disqualified_for IS NULL)),
    CONSTRAINT ck_teams_is_accepted_or_refused CHECK (approved_at IS NULL OR refused_for IS NULL),
    CONSTRAINT uq_teams_name_key UNIQUE (name_key)
);
CREATE TABLE tree_nodes (
    level SMALLINT NOT NULL,
    number BIGINT NOT NULL,
    hash BYTEA NOT NULL,
    CONSTRAINT pk_tree_nodes PRIMARY KEY (level, number)
);
CREATE TABLE work (
    id BIGINT GENERATED ALWAYS AS IDENTITY,
    kind VARCHAR(16) NOT NULL,
    owner TEXT NOT NULL,
    requires TEXT NOT NULL,
    priority SMALLINT NOT NULL,
    turn INTEGER DEFAULT 0 NOT NULL,
    state VARCHAR(16) DEFAULT 'queued' NOT NULL,
    token BIGINT DEFAULT 0 NOT NULL,
    attempts INTEGER DEFAULT 0 NOT NULL,
    worker_id UUID,
    not_before TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    queued_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    started_at TIMESTAMP WITH TIME ZONE,
    progressed_at TIMESTAMP WITH TIME ZONE,
    lease_expires_at TIMESTAMP WITH TIME ZONE,
    finished_at TIMESTAMP WITH TIME ZONE,
    repeats JSONB DEFAULT '[]' NOT NULL,
    problem TEXT,
    CONSTRAINT pk_work PRIMARY KEY (id),
    CONSTRAINT ck_work_running_has_a_lease CHECK ((state = 'running') = (lease_expires_at IS NOT NULL)),
    CONSTRAINT ck_work_running_has_a_worker CHECK ((state = 'running') <= (worker_id IS NOT NULL)),
    CONSTRAINT ck_work_each_attempt_has_a_token CHECK (attempts >= 0 AND token >= attempts),
    CONSTRAINT ck_work_problem_is_a_failure CHECK (problem IS NULL OR state = 'failed'),
    CONSTRAINT ck_work_failed_has_a_problem CHECK (state <> 'failed' OR problem IS NOT NULL OR kind IN ('shard', 'trial')),
    CONSTRAINT ck_work_kind CHECK (kind IN ('sensor_check', 'replay', 'playback', 'trial', 'shard')),
    CONSTRAINT ck_work_state CHECK (state IN ('queued', 'running', 'done', 'failed', 'cancelled'))
);
CREATE INDEX ix_work_open ON work (kind, owner) WHERE state IN ('queued', 'running');
CREATE INDEX ix_work_queued ON work (priority, (token = 0), turn, id) WHERE state = 'queued';
CREATE INDEX ix_work_shared ON work (kind, started_at) WHERE kind NOT IN ('shard', 'trial');
CREATE UNIQUE INDEX uq_work_place ON work (kind, owner) WHERE state = 'running' AND kind = 'sensor_check';
CREATE TABLE workers (
    id UUID NOT NULL,
    host TEXT NOT NULL,
    pid INTEGER NOT NULL,
    slots INTEGER NOT NULL,
    state VARCHAR(16) NOT NULL,
    evaluator_version TEXT NOT NULL,
    families TEXT[] DEFAULT '{tactile}' NOT NULL,
    has_gpu BOOLEAN DEFAULT false NOT NULL,
    platform_class TEXT NOT NULL,
    isolation TEXT NOT NULL,
    worker_order VARCHAR(16) DEFAULT 'work' NOT NULL,
    message TEXT NOT NULL,
    started_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    heartbeat_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    disk_bytes BIGINT,
    disk_free_bytes BIGINT,
    sandbox JSONB,
    CONSTRAINT pk_workers PRIMARY KEY (id),
    CONSTRAINT ck_workers_state CHECK (state IN ('ready', 'refusing', 'stopped', 'cordoned')),
    CONSTRAINT ck_workers_worker_order CHECK (worker_order IN ('work', 'cordon', 'drain'))
);
CREATE INDEX ix_workers_heartbeat_at ON workers (heartbeat_at);
CREATE TABLE announcements (
    id SERIAL NOT NULL,
    competition TEXT DEFAULT '' NOT NULL,
    team_id UUID,
    title VARCHAR(120) NOT NULL,
    text TEXT NOT NULL,
    published_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    withdrawn_at TIMESTAMP WITH TIME ZONE,
    CONSTRAINT pk_announcements PRIMARY KEY (id),
    CONSTRAINT fk_announcements_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE
);
CREATE INDEX ix_announcements_team_id ON announcements (team_id);
CREATE TABLE invitations (
    id UUID NOT NULL,
    team_id UUID NOT NULL,
    code_sha256 VARCHAR(64) NOT NULL,
    created_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    expires_at TIMESTAMP WITH TIME ZONE NOT NULL,
    used_at TIMESTAMP WITH TIME ZONE,
    revoked_at TIMESTAMP WITH TIME ZONE,
    leads BOOLEAN DEFAULT false NOT NULL,
    CONSTRAINT pk_invitations PRIMARY KEY (id),
    CONSTRAINT ck_invitations_code_is_hashed CHECK (length(code_sha256) = 64),
    CONSTRAINT ck_invitations_is_used_or_revoked CHECK (used_at IS NULL OR revoked_at IS NULL),
    CONSTRAINT fk_invitations_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE,
    CONSTRAINT uq_invitations_code_sha256 UNIQUE (code_sha256)
);
CREATE INDEX ix_invitations_team_id ON invitations (team_id);
CREATE TABLE briefs (
    competition TEXT NOT NULL,
    track TEXT NOT NULL,
    stage TEXT NOT NULL,
    team_id UUID NOT NULL,
    content BYTEA NOT NULL,
    sha256 TEXT NOT NULL,
    pages INTEGER NOT NULL,
    received_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    accepted BOOLEAN,
    reason TEXT DEFAULT '' NOT NULL,
    decided_by TEXT,
    decided_at TIMESTAMP WITH TIME ZONE,
    CONSTRAINT pk_briefs PRIMARY KEY (competition, track, stage, team_id),
    CONSTRAINT ck_briefs_sha256_is_sha256 CHECK (sha256 ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_briefs_decision_has_a_time CHECK ((accepted IS NULL) = (decided_at IS NULL)),
    CONSTRAINT fk_briefs_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE
);
CREATE TABLE entered_results (
    id SERIAL NOT NULL,
    competition TEXT NOT NULL,
    track TEXT NOT NULL,
    stage TEXT NOT NULL,
    team_id UUID,
    baseline TEXT,
    attempt INTEGER NOT NULL,
    points JSONB NOT NULL,
    evidence TEXT NOT NULL,
    entered_by TEXT NOT NULL,
    entered_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_entered_results PRIMARY KEY (id),
    CONSTRAINT uq_entered_results_competition_track_stage_team_id_base_91b7 UNIQUE NULLS NOT DISTINCT (competition, track, stage, team_id, baseline, attempt),
    CONSTRAINT ck_entered_results_is_of_a_team_or_a_baseline CHECK ((team_id IS NULL) <> (baseline IS NULL)),
    CONSTRAINT ck_entered_results_attempt_is_counted_from_1 CHECK (attempt >= 1),
    CONSTRAINT fk_entered_results_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE
);
CREATE TABLE human_baselines (
    track TEXT NOT NULL,
    task TEXT NOT NULL,
    episodes JSONB NOT NULL,
    published_by TEXT NOT NULL,
    published_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_human_baselines PRIMARY KEY (track, task)
);
CREATE TABLE judging_conflicts (
    team_id UUID NOT NULL,
    judge TEXT NOT NULL,
    reason TEXT NOT NULL,
    declared_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_judging_conflicts PRIMARY KEY (team_id, judge),
    CONSTRAINT fk_judging_conflicts_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE
);
CREATE TABLE members (
    id UUID NOT NULL,
    team_id UUID NOT NULL,
    role VARCHAR(16) NOT NULL,
    name VARCHAR(64) NOT NULL,
    name_key VARCHAR(64) NOT NULL,
    email VARCHAR(254),
    email_confirmed_at TIMESTAMP WITH TIME ZONE,
    email_code_sha256 TEXT,
    password_hash TEXT,
    muted TEXT[] DEFAULT '{}' NOT NULL,
    joined_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    left_at TIMESTAMP WITH TIME ZONE,
    CONSTRAINT pk_members PRIMARY KEY (id),
    CONSTRAINT uq_members_team_id_name_key UNIQUE (team_id, name_key),
    CONSTRAINT ck_members_who_has_left_has_no_password CHECK (left_at IS NULL OR (password_hash IS NULL AND email IS NULL)),
    CONSTRAINT fk_members_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE,
    CONSTRAINT ck_members_role CHECK (role IN ('captain', 'member'))
);
CREATE UNIQUE INDEX uq_members_captain ON members (team_id) WHERE role = 'captain' AND left_at IS NULL;
CREATE TABLE notices (
    id UUID DEFAULT gen_random_uuid() NOT NULL,
    kind VARCHAR(16) NOT NULL,
    team_id UUID NOT NULL,
    subject TEXT NOT NULL,
    channel VARCHAR(16) NOT NULL,
    target TEXT NOT NULL,
    facts JSONB NOT NULL,
    created_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    due_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    attempts INTEGER DEFAULT 0 NOT NULL,
    sent_at TIMESTAMP WITH TIME ZONE,
    given_up_at TIMESTAMP WITH TIME ZONE,
    problem TEXT,
    CONSTRAINT pk_notices PRIMARY KEY (id),
    CONSTRAINT uq_notices_once UNIQUE (kind, subject, channel, target),
    CONSTRAINT ck_notices_attempts_are_counted CHECK (attempts >= 0),
    CONSTRAINT ck_notices_is_sent_or_given_up CHECK (sent_at IS NULL OR given_up_at IS NULL),
    CONSTRAINT ck_notices_kind CHECK (kind IN ('accepted', 'finished', 'failed', 'promoted', 'deadline', 'announcement', 'confirmation')),
    CONSTRAINT fk_notices_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE,
    CONSTRAINT ck_notices_channel CHECK (channel IN ('mail', 'webhook'))
);
CREATE INDEX ix_notices_due ON notices (due_at) WHERE sent_at IS NULL AND given_up_at IS NULL;
CREATE INDEX ix_notices_of_team ON notices (team_id, created_at);
CREATE TABLE qualifications (
    competition TEXT NOT NULL,
    track TEXT NOT NULL,
    stage TEXT NOT NULL,
    team_id UUID NOT NULL,
    confirmed_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_qualifications PRIMARY KEY (competition, track, stage, team_id),
    CONSTRAINT fk_qualifications_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE
);
CREATE TABLE questions (
    id SERIAL NOT NULL,
    team_id UUID,
    text TEXT NOT NULL,
    public BOOLEAN NOT NULL,
    asked_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    answer TEXT,
    answered_at TIMESTAMP WITH TIME ZONE,
    hidden_at TIMESTAMP WITH TIME ZONE,
    CONSTRAINT pk_questions PRIMARY KEY (id),
    CONSTRAINT ck_questions_answer_has_a_time CHECK ((answer IS NULL) = (answered_at IS NULL)),
    CONSTRAINT fk_questions_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE SET NULL
);
CREATE INDEX ix_questions_team_id ON questions (team_id);
CREATE TABLE submissions (
    id UUID NOT NULL,
    team_id UUID NOT NULL,
    kind VARCHAR(16) NOT NULL,
    competition TEXT DEFAULT '' NOT NULL,
    track TEXT NOT NULL,
    stage TEXT DEFAULT '' NOT NULL,
    tasks TEXT[] NOT NULL,
    name VARCHAR(128) NOT NULL,
    digest VARCHAR(64) NOT NULL,
    archive_sha256 VARCHAR(64) NOT NULL,
    archive_bytes BIGINT NOT NULL,
    manifest JSONB NOT NULL,
    submitted_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    merged_from UUID,
    is_public BOOLEAN DEFAULT false NOT NULL,
    disqualified_at TIMESTAMP WITH TIME ZONE,
    disqualified_for TEXT,
    withdrawn_at TIMESTAMP WITH TIME ZONE,
    erased_at TIMESTAMP WITH TIME ZONE,
    copy_cleared_at TIMESTAMP WITH TIME ZONE,
    copy_cleared_for TEXT,
    archive_sketch BYTEA,
    description JSONB,
    description_removed_for TEXT,
    contents JSONB,
    chosen_at TIMESTAMP WITH TIME ZONE,
    final_of UUID,
    CONSTRAINT pk_submissions PRIMARY KEY (id),
    CONSTRAINT uq_submissions_final_of UNIQUE (final_of),
    CONSTRAINT ck_submissions_digest_is_sha256 CHECK (digest ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_submissions_archive_sha256_is_sha256 CHECK (archive_sha256 ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_submissions_archive_is_not_empty CHECK (archive_bytes > 0),
    CONSTRAINT ck_submissions_disqualified_for_a_reason CHECK ((disqualified_at IS NULL) = (disqualified_for IS NULL)),
    CONSTRAINT ck_submissions_erased_is_withdrawn CHECK (erased_at IS NULL OR withdrawn_at IS NOT NULL),
    CONSTRAINT ck_submissions_copy_cleared_for_a_reason CHECK ((copy_cleared_at IS NULL) = (copy_cleared_for IS NULL)),
    CONSTRAINT fk_submissions_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE RESTRICT,
    CONSTRAINT fk_submissions_final_of FOREIGN KEY(final_of) REFERENCES submissions (id) ON DELETE RESTRICT,
    CONSTRAINT ck_submissions_kind CHECK (kind IN ('model', 'image', 'log', 'remote', 'text_log'))
);
CREATE INDEX ix_submissions_of_team ON submissions (team_id, submitted_at DESC, id DESC);
CREATE INDEX ix_submissions_submitted_at_id ON submissions (submitted_at DESC, id DESC);
CREATE UNIQUE INDEX uq_submissions_content ON submissions (team_id, competition, track, stage, kind, digest) WHERE merged_from IS NULL;
CREATE TABLE team_quotas (
    team_id UUID NOT NULL,
    quota VARCHAR(32) NOT NULL,
    most INTEGER,
    CONSTRAINT pk_team_quotas PRIMARY KEY (team_id, quota),
    CONSTRAINT ck_team_quotas_is_a_number CHECK (most >= 0),
    CONSTRAINT fk_team_quotas_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE,
    CONSTRAINT ck_team_quotas_quota CHECK (quota IN ('scored_runs_per_day', 'attempts_per_day', 'queued_at_once', 'tokens', 'event_streams', 'stored_mib'))
);
CREATE TABLE webhooks (
    id UUID NOT NULL,
    team_id UUID NOT NULL,
    address TEXT NOT NULL,
    secret TEXT NOT NULL,
    created_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_webhooks PRIMARY KEY (id),
    CONSTRAINT ck_webhooks_secret_is_long CHECK (length(secret) = 64),
    CONSTRAINT fk_webhooks_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE
);
CREATE INDEX ix_webhooks_team_id ON webhooks (team_id);
CREATE TABLE api_tokens (
    id UUID NOT NULL,
    role VARCHAR(16) NOT NULL,
    competition TEXT,
    team_id UUID,
    member_id UUID,
    is_session BOOLEAN DEFAULT false NOT NULL,
    label VARCHAR(64) NOT NULL,
    secret_sha256 VARCHAR(64) NOT NULL,
    created_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    expires_at TIMESTAMP WITH TIME ZONE,
    revoked_at TIMESTAMP WITH TIME ZONE,
    last_used_at TIMESTAMP WITH TIME ZONE,
    CONSTRAINT pk_api_tokens PRIMARY KEY (id),
    CONSTRAINT ck_api_tokens_team_tokens_have_a_team CHECK ((role = 'team') = (team_id IS NOT NULL)),
    CONSTRAINT ck_api_tokens_secret_is_hashed CHECK (length(secret_sha256) = 64),
    CONSTRAINT ck_api_tokens_a_competition_has_organizers CHECK (competition IS NULL OR role = 'organizer'),
    CONSTRAINT ck_api_tokens_members_have_a_team CHECK (member_id IS NULL OR team_id IS NOT NULL),
    CONSTRAINT ck_api_tokens_sessions_have_a_member CHECK (NOT is_session OR member_id IS NOT NULL),
    CONSTRAINT ck_api_tokens_role CHECK (role IN ('team', 'judge', 'organizer')),
    CONSTRAINT fk_api_tokens_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE,
    CONSTRAINT fk_api_tokens_member_id FOREIGN KEY(member_id) REFERENCES members (id) ON DELETE CASCADE,
    CONSTRAINT uq_api_tokens_secret_sha256 UNIQUE (secret_sha256)
);
CREATE INDEX ix_api_tokens_member_id ON api_tokens (member_id);
CREATE INDEX ix_api_tokens_team_id ON api_tokens (team_id);
CREATE UNIQUE INDEX uq_api_tokens_of_member ON api_tokens (member_id) WHERE revoked_at IS NULL AND NOT is_session;
CREATE TABLE archive_copies (
    submission_id UUID NOT NULL,
    earlier_submission_id UUID NOT NULL,
    code FLOAT,
    weights FLOAT,
    found_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_archive_copies PRIMARY KEY (submission_id, earlier_submission_id),
    CONSTRAINT fk_archive_copies_submission_id FOREIGN KEY(submission_id) REFERENCES submissions (id) ON DELETE CASCADE,
    CONSTRAINT fk_archive_copies_earlier_submission_id FOREIGN KEY(earlier_submission_id) REFERENCES submissions (id) ON DELETE CASCADE
);
CREATE TABLE evaluations (
    id UUID NOT NULL,
    submission_id UUID NOT NULL,
    run INTEGER NOT NULL,
    evaluator_version TEXT NOT NULL,
    evaluator_hash VARCHAR(64) NOT NULL,
    platform_class TEXT,
    commitment VARCHAR(64),
    state VARCHAR(16) NOT NULL,
    episodes_reused INTEGER NOT NULL,
    rejudgement_id UUID,
    is_proposed BOOLEAN DEFAULT false NOT NULL,
    turn INTEGER DEFAULT 0 NOT NULL,
    charged_at TIMESTAMP WITH TIME ZONE,
    asked_by_team BOOLEAN DEFAULT true NOT NULL,
    created_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    started_at TIMESTAMP WITH TIME ZONE,
    finished_at TIMESTAMP WITH TIME ZONE,
    verdict_code TEXT,
    verdict_message TEXT,
    verdict_task TEXT,
    verdict_episode INTEGER,
    log_tail TEXT NOT NULL,
    scores JSONB,
    list_kind VARCHAR(16) NOT NULL,
    counted_tasks TEXT[],
    practice_scores JSONB,
    fresh_commitment VARCHAR(64),
    fresh_scores JSONB,
    result_hash VARCHAR(64),
    packages JSONB DEFAULT '[]' NOT NULL,
    traceparent TEXT,
    CONSTRAINT pk_evaluations PRIMARY KEY (id),
    CONSTRAINT ck_evaluations_run_counts_from_one CHECK (run >= 1),
    CONSTRAINT ck_evaluations_finished_has_a_time CHECK ((state IN ('completed', 'failed', 'cancelled')) = (finished_at IS NOT NULL)),
    CONSTRAINT ck_evaluations_only_completed_has_a_score CHECK ((state = 'completed') = (result_hash IS NOT NULL AND scores IS NOT NULL)),
    CONSTRAINT ck_evaluations_only_failed_has_a_verdict CHECK ((state = 'failed') = (verdict_code IS NOT NULL)),
    CONSTRAINT ck_evaluations_proposed_by_a_rejudgement CHECK (NOT is_proposed OR rejudgement_id IS NOT NULL),
    CONSTRAINT ck_evaluations_result_hash_is_sha256 CHECK (result_hash ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_evaluations_evaluator_hash_is_sha256 CHECK (evaluator_hash ~ '^[0-9a-f]{64}$'),
    CONSTRAINT fk_evaluations_submission_id FOREIGN KEY(submission_id) REFERENCES submissions (id) ON DELETE RESTRICT,
    CONSTRAINT fk_evaluations_commitment FOREIGN KEY(commitment) REFERENCES sealed_lists (commitment) ON DELETE RESTRICT,
    CONSTRAINT ck_evaluations_state CHECK (state IN ('queued', 'running', 'completed', 'failed', 'cancelled')),
    CONSTRAINT fk_evaluations_rejudgement_id FOREIGN KEY(rejudgement_id) REFERENCES rejudgements (id) ON DELETE RESTRICT,
    CONSTRAINT ck_evaluations_list_kind CHECK (list_kind IN ('public', 'sealed'))
);
CREATE INDEX ix_evaluations_charged_at ON evaluations (charged_at) WHERE charged_at IS NOT NULL;
CREATE INDEX ix_evaluations_completed_finished_at ON evaluations (finished_at) WHERE state = 'completed';
CREATE INDEX ix_evaluations_rejudgement_id ON evaluations (rejudgement_id) WHERE rejudgement_id IS NOT NULL;
CREATE INDEX ix_evaluations_state_created_at ON evaluations (state, created_at);
CREATE INDEX ix_evaluations_submission_id ON evaluations (submission_id);
CREATE UNIQUE INDEX uq_evaluations_active ON evaluations (submission_id) WHERE state IN ('queued', 'running');
CREATE UNIQUE INDEX uq_evaluations_run ON evaluations (submission_id, evaluator_version, run) WHERE state IN ('queued', 'running', 'completed');
CREATE TABLE judging_marks (
    submission_id UUID NOT NULL,
    judge TEXT NOT NULL,
    criterion TEXT NOT NULL,
    mark FLOAT NOT NULL,
    given_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_judging_marks PRIMARY KEY (submission_id, judge, criterion),
    CONSTRAINT ck_judging_marks_mark_is_in_range CHECK (mark >= 0 AND mark <= 10),
    CONSTRAINT fk_judging_marks_submission_id FOREIGN KEY(submission_id) REFERENCES submissions (id) ON DELETE CASCADE
);
CREATE TABLE partial_uploads (
    id UUID NOT NULL,
    team_id UUID NOT NULL,
    kind VARCHAR(16) NOT NULL,
    track TEXT,
    competition TEXT,
    again BOOLEAN NOT NULL,
    file_name TEXT,
    total_bytes BIGINT NOT NULL,
    received_bytes BIGINT NOT NULL,
    sha256 VARCHAR(64),
    created_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    completed_at TIMESTAMP WITH TIME ZONE,
    expires_at TIMESTAMP WITH TIME ZONE NOT NULL,
    submission_id UUID,
    CONSTRAINT pk_partial_uploads PRIMARY KEY (id),
    CONSTRAINT ck_partial_uploads_received_is_a_part CHECK (received_bytes >= 0 AND received_bytes <= total_bytes),
    CONSTRAINT ck_partial_uploads_is_not_empty CHECK (total_bytes > 0),
    CONSTRAINT ck_partial_uploads_sha256_is_sha256 CHECK (sha256 ~ '^[0-9a-f]{64}$'),
    CONSTRAINT fk_partial_uploads_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE,
    CONSTRAINT ck_partial_uploads_kind CHECK (kind IN ('model', 'image', 'log', 'remote', 'text_log')),
    CONSTRAINT fk_partial_uploads_submission_id FOREIGN KEY(submission_id) REFERENCES submissions (id) ON DELETE CASCADE
);
CREATE INDEX ix_partial_uploads_expires_at ON partial_uploads (expires_at);
CREATE INDEX ix_partial_uploads_team_id ON partial_uploads (team_id);
CREATE TABLE submission_files (
    submission_id UUID NOT NULL,
    role VARCHAR(16) NOT NULL,
    sha256 VARCHAR(64) NOT NULL,
    n_bytes BIGINT NOT NULL,
    name VARCHAR(128) NOT NULL,
    facts JSONB NOT NULL,
    CONSTRAINT pk_submission_files PRIMARY KEY (submission_id, role, sha256),
    CONSTRAINT ck_submission_files_sha256_is_sha256 CHECK (sha256 ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_submission_files_is_not_empty CHECK (n_bytes > 0),
    CONSTRAINT fk_submission_files_submission_id FOREIGN KEY(submission_id) REFERENCES submissions (id) ON DELETE CASCADE,
    CONSTRAINT ck_submission_files_role CHECK (role IN ('sensor', 'document', 'coefficients', 'video', 'figures'))
);
CREATE TABLE action_traces (
    evaluation_id UUID NOT NULL,
    task TEXT NOT NULL,
    commitment TEXT NOT NULL,
    action_size INTEGER NOT NULL,
    actions BYTEA NOT NULL,
    paths BYTEA DEFAULT '' NOT NULL,
    CONSTRAINT pk_action_traces PRIMARY KEY (evaluation_id, task, commitment),
    CONSTRAINT fk_action_traces_evaluation_id FOREIGN KEY(evaluation_id) REFERENCES evaluations (id) ON DELETE CASCADE
);
CREATE INDEX ix_action_traces_task_commitment ON action_traces (task, commitment);
CREATE TABLE appeals (
    id SERIAL NOT NULL,
    team_id UUID NOT NULL,
    evaluation_id UUID NOT NULL,
    task TEXT,
    episode INTEGER,
    text TEXT NOT NULL,
    state VARCHAR(16) NOT NULL,
    opened_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    ended_at TIMESTAMP WITH TIME ZONE,
    ruling TEXT,
    CONSTRAINT pk_appeals PRIMARY KEY (id),
    CONSTRAINT ck_appeals_episodes_have_a_task CHECK ((task IS NULL) = (episode IS NULL)),
    CONSTRAINT ck_appeals_ended_has_a_time CHECK ((state = 'open') = (ended_at IS NULL)),
    CONSTRAINT ck_appeals_ruled_on_has_a_ruling CHECK ((state IN ('upheld', 'rejected')) = (ruling IS NOT NULL)),
    CONSTRAINT fk_appeals_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE CASCADE,
    CONSTRAINT fk_appeals_evaluation_id FOREIGN KEY(evaluation_id) REFERENCES evaluations (id) ON DELETE CASCADE,
    CONSTRAINT ck_appeals_state CHECK (state IN ('open', 'upheld', 'rejected', 'withdrawn'))
);
CREATE INDEX ix_appeals_team_id ON appeals (team_id);
CREATE UNIQUE INDEX uq_appeals_open ON appeals (evaluation_id) WHERE state = 'open';
CREATE TABLE board_results (
    evaluation_id UUID NOT NULL,
    board TEXT NOT NULL,
    competition TEXT DEFAULT '' NOT NULL,
    track TEXT NOT NULL,
    stage TEXT DEFAULT '' NOT NULL,
    kind VARCHAR(16) NOT NULL,
    team_id UUID NOT NULL,
    submission_id UUID NOT NULL,
    evaluator_version TEXT NOT NULL,
    ranked_by JSONB NOT NULL,
    sort_key FLOAT[] NOT NULL,
    submitted_at TIMESTAMP WITH TIME ZONE NOT NULL,
    finished_at TIMESTAMP WITH TIME ZONE NOT NULL,
    is_copy BOOLEAN DEFAULT false NOT NULL,
    is_off_boards BOOLEAN DEFAULT false NOT NULL,
    CONSTRAINT pk_board_results PRIMARY KEY (evaluation_id, board),
    CONSTRAINT fk_board_results_evaluation_id FOREIGN KEY(evaluation_id) REFERENCES evaluations (id) ON DELETE CASCADE,
    CONSTRAINT ck_board_results_kind CHECK (kind IN ('model', 'image', 'log', 'remote', 'text_log')),
    CONSTRAINT fk_board_results_team_id FOREIGN KEY(team_id) REFERENCES teams (id) ON DELETE RESTRICT,
    CONSTRAINT fk_board_results_submission_id FOREIGN KEY(submission_id) REFERENCES submissions (id) ON DELETE RESTRICT
);
CREATE INDEX ix_board_results_of_team ON board_results (competition, track, stage, kind, board, team_id, sort_key, evaluation_id);
CREATE INDEX ix_board_results_of_version ON board_results (competition, track, stage, kind, board, evaluator_version, team_id, sort_key, evaluation_id);
CREATE TABLE episode_differences (
    id BIGINT GENERATED ALWAYS AS IDENTITY,
    evaluation_id UUID NOT NULL,
    task TEXT NOT NULL,
    episode INTEGER NOT NULL,
    stored_digest VARCHAR(64) NOT NULL,
    differing_digest VARCHAR(64) NOT NULL,
    worker_id UUID,
    seen_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_episode_differences PRIMARY KEY (id),
    CONSTRAINT uq_episode_differences_key UNIQUE (evaluation_id, task, episode, differing_digest),
    CONSTRAINT ck_episode_differences_records_differ CHECK (stored_digest <> differing_digest),
    CONSTRAINT ck_episode_differences_stored_digest_is_sha256 CHECK (stored_digest ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_episode_differences_differing_digest_is_sha256 CHECK (differing_digest ~ '^[0-9a-f]{64}$'),
    CONSTRAINT fk_episode_differences_evaluation_id FOREIGN KEY(evaluation_id) REFERENCES evaluations (id) ON DELETE CASCADE
);
CREATE TABLE episode_results (
    id BIGINT GENERATED ALWAYS AS IDENTITY,
    submission_digest VARCHAR(64) NOT NULL,
    evaluator_version TEXT NOT NULL,
    track TEXT NOT NULL,
    task TEXT NOT NULL,
    episode INTEGER NOT NULL,
    run INTEGER NOT NULL,
    commitment TEXT DEFAULT '' NOT NULL,
    shape TEXT NOT NULL,
    initial_offset FLOAT[] NOT NULL,
    outcome TEXT NOT NULL,
    success BOOLEAN NOT NULL,
    env_steps INTEGER NOT NULL,
    record JSONB NOT NULL,
    forces JSONB,
    record_digest VARCHAR(64) NOT NULL,
    states_digest VARCHAR(64) NOT NULL,
    half_way_state VARCHAR(64) NOT NULL,
    wall_s FLOAT NOT NULL,
    output TEXT DEFAULT '' NOT NULL,
    evaluation_id UUID,
    created_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_episode_results PRIMARY KEY (id),
    CONSTRAINT uq_episode_results_key UNIQUE (submission_digest, evaluator_version, track, task, episode, run, commitment),
    CONSTRAINT ck_episode_results_success_is_the_outcome CHECK (success = (outcome = 'success')),
    CONSTRAINT ck_episode_results_counts_from_one CHECK (episode >= 1 AND run >= 1 AND env_steps >= 0),
    CONSTRAINT ck_episode_results_submission_digest_is_sha256 CHECK (submission_digest ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_episode_results_record_digest_is_sha256 CHECK (record_digest ~ '^[0-9a-f]{64}$'),
    CONSTRAINT fk_episode_results_evaluation_id FOREIGN KEY(evaluation_id) REFERENCES evaluations (id) ON DELETE SET NULL
);
CREATE INDEX ix_episode_results_evaluation_id ON episode_results (evaluation_id);
CREATE INDEX ix_episode_results_half_way_state ON episode_results (half_way_state);
CREATE INDEX ix_episode_results_task_created_at ON episode_results (task, created_at DESC);
CREATE TABLE fresh_lists (
    commitment VARCHAR(64) NOT NULL,
    evaluation_id UUID NOT NULL,
    secret VARCHAR(64) NOT NULL,
    CONSTRAINT pk_fresh_lists PRIMARY KEY (commitment),
    CONSTRAINT ck_fresh_lists_commitment_is_sha256 CHECK (commitment ~ '^[0-9a-f]{64}$'),
    CONSTRAINT fk_fresh_lists_evaluation_id FOREIGN KEY(evaluation_id) REFERENCES evaluations (id) ON DELETE CASCADE
);
CREATE INDEX ix_fresh_lists_evaluation_id ON fresh_lists (evaluation_id);
CREATE TABLE log_copies (
    evaluation_id UUID NOT NULL,
    earlier_submission_id UUID NOT NULL,
    episodes INTEGER NOT NULL,
    found_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_log_copies PRIMARY KEY (evaluation_id),
    CONSTRAINT ck_log_copies_some_are_equal CHECK (episodes > 0),
    CONSTRAINT fk_log_copies_evaluation_id FOREIGN KEY(evaluation_id) REFERENCES evaluations (id) ON DELETE CASCADE,
    CONSTRAINT fk_log_copies_earlier_submission_id FOREIGN KEY(earlier_submission_id) REFERENCES submissions (id) ON DELETE CASCADE
);
CREATE TABLE near_copies (
    evaluation_id UUID NOT NULL,
    earlier_submission_id UUID NOT NULL,
    task TEXT NOT NULL,
    commitment TEXT NOT NULL,
    near INTEGER NOT NULL,
    episodes INTEGER NOT NULL,
    difference FLOAT NOT NULL,
    found_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    CONSTRAINT pk_near_copies PRIMARY KEY (evaluation_id, earlier_submission_id, task, commitment),
    CONSTRAINT ck_near_copies_some_are_near CHECK (near > 0 AND near <= episodes),
    CONSTRAINT fk_near_copies_evaluation_id FOREIGN KEY(evaluation_id) REFERENCES evaluations (id) ON DELETE CASCADE,
    CONSTRAINT fk_near_copies_earlier_submission_id FOREIGN KEY(earlier_submission_id) REFERENCES submissions (id) ON DELETE CASCADE
);
CREATE TABLE receipts (
    number BIGINT NOT NULL,
    submission_id UUID,
    evaluation_id UUID,
    stands_for TEXT NOT NULL,
    content TEXT NOT NULL,
    board TEXT NOT NULL,
    entry TEXT NOT NULL,
    leaf_hash BYTEA NOT NULL,
    CONSTRAINT pk_receipts PRIMARY KEY (number),
    CONSTRAINT ck_receipts_counts_from_one CHECK (number >= 1),
    CONSTRAINT ck_receipts_arrival_has_submission CHECK ((stands_for = 'submission') = (submission_id IS NOT NULL)),
    CONSTRAINT ck_receipts_result_has_evaluation CHECK ((stands_for = 'result') = (evaluation_id IS NOT NULL)),
    CONSTRAINT ck_receipts_leaf_hash_is_sha256 CHECK (octet_length(leaf_hash) = 32),
    CONSTRAINT uq_receipts_submission_id UNIQUE (submission_id),
    CONSTRAINT fk_receipts_submission_id FOREIGN KEY(submission_id) REFERENCES submissions (id) ON DELETE RESTRICT,
    CONSTRAINT uq_receipts_evaluation_id UNIQUE (evaluation_id),
    CONSTRAINT fk_receipts_evaluation_id FOREIGN KEY(evaluation_id) REFERENCES evaluations (id) ON DELETE RESTRICT
);
CREATE INDEX ix_receipts_board ON receipts (board);
CREATE TABLE sensor_checks (
    id BIGINT NOT NULL,
    evaluation_id UUID NOT NULL,
    CONSTRAINT pk_sensor_checks PRIMARY KEY (id),
    CONSTRAINT fk_sensor_checks_id FOREIGN KEY(id) REFERENCES work (id) ON DELETE CASCADE,
    CONSTRAINT uq_sensor_checks_evaluation_id UNIQUE (evaluation_id),
    CONSTRAINT fk_sensor_checks_evaluation_id FOREIGN KEY(evaluation_id) REFERENCES evaluations (id) ON DELETE CASCADE
);
CREATE TABLE shards (
    id BIGINT NOT NULL,
    evaluation_id UUID NOT NULL,
    task TEXT NOT NULL,
    number INTEGER NOT NULL,
    commitment TEXT DEFAULT '' NOT NULL,
    episodes INTEGER[] NOT NULL,
    manifest JSONB,
    isolation TEXT,
    packages_digest VARCHAR(64),
    finding JSONB,
    code VARCHAR(16),
    CONSTRAINT pk_shards PRIMARY KEY (id),
    CONSTRAINT uq_shards_evaluation_id_task_number_commitment UNIQUE (evaluation_id, task, number, commitment),
    CONSTRAINT ck_shards_has_episodes CHECK (cardinality(episodes) > 0),
    CONSTRAINT fk_shards_id FOREIGN KEY(id) REFERENCES work (id) ON DELETE CASCADE,
    CONSTRAINT fk_shards_evaluation_id FOREIGN KEY(evaluation_id) REFERENCES evaluations (id) ON DELETE CASCADE
);
CREATE TABLE upload_parts (
    upload_id UUID NOT NULL,
    first_byte BIGINT NOT NULL,
    n_bytes INTEGER NOT NULL,
    key TEXT NOT NULL,
    CONSTRAINT pk_upload_parts PRIMARY KEY (upload_id, first_byte),
    CONSTRAINT ck_upload_parts_is_not_empty CHECK (n_bytes > 0),
    CONSTRAINT fk_upload_parts_upload_id FOREIGN KEY(upload_id) REFERENCES partial_uploads (id) ON DELETE CASCADE
);
CREATE TABLE appeal_replays (
    id BIGINT NOT NULL,
    appeal_id INTEGER NOT NULL,
    task TEXT NOT NULL,
    episode INTEGER NOT NULL,
    policy_sha256 VARCHAR(64) NOT NULL,
    corrected BOOLEAN NOT NULL,
    outcome TEXT,
    env_steps INTEGER,
    same_states BOOLEAN,
    failure TEXT,
    old_outcome TEXT NOT NULL,
    old_env_steps INTEGER NOT NULL,
    CONSTRAINT pk_appeal_replays PRIMARY KEY (id),
    CONSTRAINT ck_appeal_replays_policy_sha256_is_sha256 CHECK (policy_sha256 ~ '^[0-9a-f]{64}$'),
    CONSTRAINT fk_appeal_replays_id FOREIGN KEY(id) REFERENCES work (id) ON DELETE CASCADE,
    CONSTRAINT fk_appeal_replays_appeal_id FOREIGN KEY(appeal_id) REFERENCES appeals (id) ON DELETE CASCADE
);
CREATE INDEX ix_appeal_replays_appeal_id ON appeal_replays (appeal_id);
CREATE TABLE playbacks (
    id BIGINT NOT NULL,
    key VARCHAR(64) NOT NULL,
    episode_id BIGINT NOT NULL,
    evaluator_version TEXT NOT NULL,
    asked_at TIMESTAMP WITH TIME ZONE DEFAULT now() NOT NULL,
    env_steps_played INTEGER NOT NULL,
    scene_sha256 VARCHAR(64),
    cameras_sha256 VARCHAR(64),
    still_sha256 VARCHAR(64),
    film_sha256 VARCHAR(64),
    CONSTRAINT pk_playbacks PRIMARY KEY (id),
    CONSTRAINT ck_playbacks_key_is_sha256 CHECK (key ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_playbacks_scene_sha256_is_sha256 CHECK (scene_sha256 ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_playbacks_cameras_sha256_is_sha256 CHECK (cameras_sha256 ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_playbacks_still_sha256_is_sha256 CHECK (still_sha256 ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_playbacks_film_sha256_is_sha256 CHECK (film_sha256 ~ '^[0-9a-f]{64}$'),
    CONSTRAINT ck_playbacks_counts_from_zero CHECK (env_steps_played >= 0),
    CONSTRAINT fk_playbacks_id FOREIGN KEY(id) REFERENCES work (id) ON DELETE CASCADE,
    CONSTRAINT uq_playbacks_key UNIQUE (key),
    CONSTRAINT fk_playbacks_episode_id FOREIGN KEY(episode_id) REFERENCES episode_results (id) ON DELETE CASCADE
);
CREATE INDEX ix_playbacks_asked_at ON playbacks (asked_at);
CREATE INDEX ix_playbacks_episode_id ON playbacks (episode_id);

-- The boards' readers begin with a note, which tells them apart from an empty table.
INSERT INTO board_changes (mark) VALUES (hashtextextended(gen_random_uuid()::text, 0));

-- States change only along their transitions (server.database.states).
CREATE FUNCTION check_evaluations_transition() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    IF (OLD.state, NEW.state) NOT IN (
        ('queued', 'running'), ('queued', 'failed'), ('queued', 'cancelled'),
        ('running', 'completed'), ('running', 'failed'), ('running', 'cancelled')
    ) THEN
        RAISE EXCEPTION 'evaluations % may not go from % to %', OLD.id, OLD.state, NEW.state
            USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_evaluations_transition';
    END IF;
    RETURN NEW;
END $$;
CREATE TRIGGER evaluations_transition BEFORE UPDATE OF state ON evaluations FOR EACH ROW
    WHEN (OLD.state IS DISTINCT FROM NEW.state) EXECUTE FUNCTION check_evaluations_transition();

CREATE FUNCTION check_work_transition() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    IF (OLD.state, NEW.state) NOT IN (
        ('queued', 'running'), ('queued', 'failed'), ('queued', 'cancelled'),
        ('running', 'queued'), ('running', 'done'), ('running', 'failed'), ('running', 'cancelled')
    ) THEN
        RAISE EXCEPTION 'work % may not go from % to %', OLD.id, OLD.state, NEW.state
            USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_work_transition';
    END IF;
    RETURN NEW;
END $$;
CREATE TRIGGER work_transition BEFORE UPDATE OF state ON work FOR EACH ROW
    WHEN (OLD.state IS DISTINCT FROM NEW.state) EXECUTE FUNCTION check_work_transition();

-- Work that is done has its result, at the end of the transaction in which it was done.
CREATE FUNCTION check_work_result() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    IF EXISTS (SELECT FROM shards WHERE id = NEW.id AND (manifest IS NULL OR finding IS NOT NULL))
        OR EXISTS (SELECT FROM playbacks WHERE id = NEW.id AND scene_sha256 IS NULL AND film_sha256 IS NULL)
        OR EXISTS (SELECT FROM appeal_replays WHERE id = NEW.id AND outcome IS NULL)
    THEN
        RAISE EXCEPTION 'work % of kind % is done without a result', NEW.id, NEW.kind
            USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_work_done_has_a_result';
    END IF;
    RETURN NULL;
END $$;
CREATE CONSTRAINT TRIGGER work_result AFTER UPDATE ON work DEFERRABLE INITIALLY DEFERRED FOR EACH ROW
    WHEN (NEW.state = 'done' AND OLD.state <> 'done') EXECUTE FUNCTION check_work_result();

-- What is removed with its evaluation, episode or appeal leaves the queue.
CREATE FUNCTION remove_work() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    DELETE FROM work WHERE id = OLD.id;
    RETURN NULL;
END $$;
CREATE TRIGGER shards_removed AFTER DELETE ON shards FOR EACH ROW EXECUTE FUNCTION remove_work();
CREATE TRIGGER sensor_checks_removed AFTER DELETE ON sensor_checks FOR EACH ROW EXECUTE FUNCTION remove_work();
CREATE TRIGGER playbacks_removed AFTER DELETE ON playbacks FOR EACH ROW EXECUTE FUNCTION remove_work();
CREATE TRIGGER appeal_replays_removed AFTER DELETE ON appeal_replays FOR EACH ROW EXECUTE FUNCTION remove_work();

-- Workers hear of what waits for them.
CREATE FUNCTION tell_workers() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('vitac_work', '');
    RETURN NULL;
END $$;
CREATE TRIGGER work_waits AFTER INSERT OR UPDATE OF state ON work FOR EACH ROW
    WHEN (NEW.state = 'queued') EXECUTE FUNCTION tell_workers();

-- Pages and streams hear of the submission whose evaluation or work has changed; renewing a lease is no change.
CREATE FUNCTION tell_of_evaluations() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('vitac_submissions', NEW.submission_id::text);
    RETURN NULL;
END $$;
CREATE TRIGGER evaluations_told AFTER INSERT OR UPDATE ON evaluations FOR EACH ROW
    EXECUTE FUNCTION tell_of_evaluations();

CREATE FUNCTION tell_of_work() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('vitac_submissions', submission_id::text) FROM evaluations WHERE id IN (
        SELECT evaluation_id FROM shards WHERE id = NEW.id
        UNION ALL SELECT evaluation_id FROM sensor_checks WHERE id = NEW.id
    );
    RETURN NULL;
END $$;
CREATE TRIGGER work_told AFTER UPDATE OF state, progressed_at ON work FOR EACH ROW
    WHEN (NEW.kind IN ('shard', 'trial', 'sensor_check')) EXECUTE FUNCTION tell_of_work();

-- Tables that only grow.
CREATE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    RAISE EXCEPTION '% is append-only', TG_TABLE_NAME
        USING ERRCODE = 'check_violation', CONSTRAINT = format('ck_%s_append_only', TG_TABLE_NAME);
END $$;
CREATE TRIGGER audit_log_append_only BEFORE UPDATE OR DELETE ON audit_log FOR EACH ROW EXECUTE FUNCTION refuse_change();
CREATE TRIGGER audit_log_not_emptied BEFORE TRUNCATE ON audit_log EXECUTE FUNCTION refuse_change();
CREATE TRIGGER receipts_append_only BEFORE UPDATE OR DELETE ON receipts FOR EACH ROW EXECUTE FUNCTION refuse_change();
CREATE TRIGGER receipts_not_emptied BEFORE TRUNCATE ON receipts EXECUTE FUNCTION refuse_change();
CREATE TRIGGER tree_nodes_append_only BEFORE UPDATE OR DELETE ON tree_nodes
    FOR EACH ROW EXECUTE FUNCTION refuse_change();
CREATE TRIGGER tree_nodes_not_emptied BEFORE TRUNCATE ON tree_nodes EXECUTE FUNCTION refuse_change();
CREATE TRIGGER cosignatures_append_only BEFORE UPDATE OR DELETE ON cosignatures
    FOR EACH ROW EXECUTE FUNCTION refuse_change();
CREATE TRIGGER cosignatures_not_emptied BEFORE TRUNCATE ON cosignatures EXECUTE FUNCTION refuse_change();

-- Each receipt follows the one before.
CREATE FUNCTION refuse_receipt_gap() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    IF NEW.number <> (SELECT coalesce(max(number), 0) + 1 FROM receipts) THEN
        RAISE EXCEPTION 'receipt % does not follow the last one', NEW.number
            USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_receipts_without_gap';
    END IF;
    RETURN NEW;
END $$;
CREATE TRIGGER receipts_without_gap BEFORE INSERT ON receipts FOR EACH ROW EXECUTE FUNCTION refuse_receipt_gap();

-- After these changes boards are read again. A new team is on no board before its first result.
CREATE FUNCTION note_board_change() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    INSERT INTO board_changes (mark) VALUES (hashtextextended(gen_random_uuid()::text, 0));
    RETURN NULL;
END $$;
CREATE TRIGGER board_results_noted AFTER INSERT OR UPDATE OR DELETE OR TRUNCATE ON board_results
    EXECUTE FUNCTION note_board_change();
CREATE TRIGGER log_copies_noted AFTER INSERT OR UPDATE OR DELETE OR TRUNCATE ON log_copies
    EXECUTE FUNCTION note_board_change();
CREATE TRIGGER human_baselines_noted AFTER INSERT OR UPDATE OR DELETE OR TRUNCATE ON human_baselines
    EXECUTE FUNCTION note_board_change();
CREATE TRIGGER submissions_noted AFTER UPDATE OF team_id ON submissions EXECUTE FUNCTION note_board_change();
CREATE TRIGGER teams_noted AFTER UPDATE OF name, named_at, disqualified_at OR DELETE ON teams
    EXECUTE FUNCTION note_board_change();
