-- A store of schema 2 with a day begun, as that desk wrote it into PostgreSQL.
CREATE TABLE about (
	name VARCHAR(40) NOT NULL, 
	value TEXT NOT NULL, 
	PRIMARY KEY (name)
);
CREATE TABLE commands (
	n BIGSERIAL NOT NULL, 
	id VARCHAR(64) NOT NULL, 
	vehicle VARCHAR(32) NOT NULL, 
	assignment VARCHAR(64), 
	deed BYTEA NOT NULL, 
	said_by VARCHAR(64) NOT NULL, 
	held BOOLEAN NOT NULL, 
	answer VARCHAR(16), 
	reason TEXT NOT NULL, 
	life VARCHAR(64), 
	made_us BIGINT NOT NULL, 
	answered_us BIGINT, 
	PRIMARY KEY (n), 
	UNIQUE (id)
);
CREATE INDEX ix_commands_answer ON commands (answer);
CREATE TABLE events (
	n BIGSERIAL NOT NULL, 
	vehicle VARCHAR(32) NOT NULL, 
	log VARCHAR(64) NOT NULL, 
	seq BIGINT NOT NULL, 
	kind VARCHAR(16) NOT NULL, 
	assignment VARCHAR(64), 
	content TEXT NOT NULL, 
	heard_us BIGINT NOT NULL, 
	PRIMARY KEY (n), 
	UNIQUE (vehicle, log, seq)
);
CREATE TABLE logs (
	vehicle VARCHAR(32) NOT NULL, 
	log VARCHAR(64) NOT NULL, 
	seen_to BIGINT NOT NULL, 
	PRIMARY KEY (vehicle, log)
);
CREATE TABLE orders (
	n BIGSERIAL NOT NULL, 
	id VARCHAR(64) NOT NULL, 
	content TEXT NOT NULL, 
	state VARCHAR(16) NOT NULL, 
	attempts INTEGER NOT NULL, 
	why TEXT NOT NULL, 
	taken_us BIGINT NOT NULL, 
	PRIMARY KEY (n), 
	UNIQUE (id)
);
CREATE INDEX ix_orders_state ON orders (state);
CREATE TABLE plans (
	revision INTEGER NOT NULL, 
	content TEXT NOT NULL, 
	why TEXT NOT NULL, 
	wind TEXT, 
	made_us BIGINT NOT NULL, 
	PRIMARY KEY (revision)
);
CREATE TABLE visits (
	stop VARCHAR(64) NOT NULL, 
	arrived_us BIGINT NOT NULL, 
	left_us BIGINT, 
	PRIMARY KEY (stop)
);
CREATE TABLE assignments (
	n BIGSERIAL NOT NULL, 
	id VARCHAR(64) NOT NULL, 
	order_id VARCHAR(64) NOT NULL, 
	vehicle VARCHAR(32) NOT NULL, 
	state VARCHAR(16) NOT NULL, 
	delivered BOOLEAN NOT NULL, 
	why TEXT NOT NULL, 
	made_us BIGINT NOT NULL, 
	ended_us BIGINT, 
	PRIMARY KEY (n), 
	UNIQUE (id), 
	FOREIGN KEY(order_id) REFERENCES orders (id)
);
CREATE INDEX ix_assignments_state ON assignments (state);
CREATE UNIQUE INDEX one_in_force_per_order_id ON assignments (order_id) WHERE state IN ('ordered', 'aboard', 'flying', 'withdrawing');
CREATE UNIQUE INDEX one_in_force_per_vehicle ON assignments (vehicle) WHERE state IN ('ordered', 'aboard', 'flying', 'withdrawing') AND vehicle <> 'truck';
CREATE TABLE sorties (
	assignment VARCHAR(64) NOT NULL, 
	content TEXT NOT NULL, 
	pads TEXT NOT NULL, 
	promised VARCHAR(64) NOT NULL, 
	asked VARCHAR(64), 
	placed BOOLEAN NOT NULL, 
	recovered BOOLEAN NOT NULL, 
	away BOOLEAN NOT NULL, 
	lapsed BOOLEAN NOT NULL, 
	launched_us BIGINT, 
	landed_us BIGINT, 
	used_wh FLOAT, 
	PRIMARY KEY (assignment), 
	FOREIGN KEY(assignment) REFERENCES assignments (id)
);
INSERT INTO about (name, value) VALUES('schema','2');
INSERT INTO orders (n, id, content, state, attempts, why, taken_us) VALUES(1,'o1','{"id":"o1","lat_deg":55.0,"lon_deg":8.0,"alt_amsl_m":3.0,"mass_kg":0.5,"service":"any","note":""}','assigned',1,'',1790000000000000);
INSERT INTO orders (n, id, content, state, attempts, why, taken_us) VALUES(2,'o2','{"id":"o2","lat_deg":55.0,"lon_deg":8.0,"alt_amsl_m":3.0,"mass_kg":0.5,"service":"any","note":""}','assigned',1,'',1790000001000000);
INSERT INTO orders (n, id, content, state, attempts, why, taken_us) VALUES(3,'o3','{"id":"o3","lat_deg":55.0,"lon_deg":8.0,"alt_amsl_m":3.0,"mass_kg":0.5,"service":"any","note":""}','open',0,'',1790000002000000);
INSERT INTO assignments (n, id, order_id, vehicle, state, delivered, why, made_us, ended_us) VALUES(1,'o1.1','o1','d1','flying',false,'',1790000003000000,NULL);
INSERT INTO assignments (n, id, order_id, vehicle, state, delivered, why, made_us, ended_us) VALUES(2,'o2.1','o2','d2','ordered',false,'',1790000010000000,NULL);
INSERT INTO commands (n, id, vehicle, assignment, deed, said_by, held, answer, reason, life, made_us, answered_us) VALUES(1,'o1.1:assign','d1','o1.1',decode('7B22646F223A2261737369676E222C2261737369676E6D656E74223A226F312E31222C226F72646572223A226F31222C22666C69676874223A7B22666F726D6174223A22666C696768742F31227D2C226F62737461636C6573223A6E756C6C7D','hex'),'desk',false,'done','','life',1790000004000000,1790000005000000);
INSERT INTO commands (n, id, vehicle, assignment, deed, said_by, held, answer, reason, life, made_us, answered_us) VALUES(2,'o1.1:launch1','d1','o1.1',decode('7B22646F223A226C61756E6368222C2261737369676E6D656E74223A226F312E31227D','hex'),'desk',false,'done','','life',1790000007000000,1790000008000000);
INSERT INTO commands (n, id, vehicle, assignment, deed, said_by, held, answer, reason, life, made_us, answered_us) VALUES(3,'o2.1:assign','d2','o2.1',decode('7B22646F223A2261737369676E222C2261737369676E6D656E74223A226F322E31222C226F72646572223A226F32222C22666C69676874223A7B22666F726D6174223A22666C696768742F31227D2C226F62737461636C6573223A6E756C6C7D','hex'),'desk',false,NULL,'',NULL,1790000011000000,NULL);
SELECT setval('orders_n_seq', 3);
SELECT setval('assignments_n_seq', 2);
SELECT setval('commands_n_seq', 3);
