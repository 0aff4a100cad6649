"""The atomic changes that concern a job and its tiles at once, as Redis runs them."""

from __future__ import annotations

# KEYS: the job's record, the list of its tiles, the set of all families
# ARGV: the job's id, its lease, fields of its record (JSON object),
#       its tiles (JSON: [id, fields, queue] each), prefix of records, index prefix,
#       prefix of the queues, feed channel
#
# All tiles or none; and none of a job that is not its worker's any more, or is to be given up.
SPLIT = """
local state = redis.call('HGET', KEYS[1], 'state')
if not state then return {'missing'} end
if state ~= 'running' then return {'illegal', state} end
if redis.call('HGET', KEYS[1], 'lease') ~= ARGV[2] then return {'fenced', state} end
local cancel = redis.call('HGET', KEYS[1], 'cancel') or ''
if cancel == 'discard' then return {'cancelled', state} end
local t = redis.call('TIME')
local now = string.format('%d', t[1] * 1000 + math.floor(t[2] / 1000))
for _, tile in ipairs(cjson.decode(ARGV[4])) do
  local id, record = tile[1], ARGV[5] .. tile[1]
  for name, value in pairs(tile[2]) do redis.call('HSET', record, name, value) end
  redis.call('HSET', record, 'cancel', cancel,
             'created_at', now, 'updated_at', now, 'queued_at', now)
  redis.call('ZADD', ARGV[6] .. 'queued', now, id)
  redis.call('ZADD', ARGV[7] .. tile[3], now, id)
  redis.call('RPUSH', KEYS[2], id)
end
redis.call('SADD', KEYS[3], ARGV[1])
for name, value in pairs(cjson.decode(ARGV[3])) do redis.call('HSET', KEYS[1], name, value) end
redis.call('HSET', KEYS[1], 'lease', '', 'updated_at', now)
redis.call('PUBLISH', ARGV[8], ARGV[1] .. ' ' .. state)
return {'ok', state, redis.call('HGET', KEYS[1], 'attempt'), cancel}
"""

# KEYS: the job's record, its stream of events
# ARGV: its id, the attempt that split it, progress (JSON), tiles (JSON), feed channel, events kept,
#       ms between two events
#
# Many tell at once, and what one of them saw may be older than what another has told: neither the
# share that is done nor the number of fitted tiles ever falls. The record is always written; those
# who listen hear of it no more often than of any job.
TELL = """
local found = redis.call('HMGET', KEYS[1], 'state', 'attempt', 'lease', 'progress', 'tiles')
if found[1] ~= 'running' or found[2] ~= ARGV[2] or found[3] ~= '' then return {'fenced'} end
local told = cjson.decode(ARGV[3])
if found[4] then
  local before = cjson.decode(found[4])
  if before ~= cjson.null and before['fraction'] > told['fraction'] then
    told['fraction'] = before['fraction']
  end
end
local tiles = ARGV[4]
if found[5] then
  local before = cjson.decode(found[5])
  if before ~= cjson.null and before['done'] > cjson.decode(tiles)['done'] then
    tiles = found[5]
  end
end
local t = redis.call('TIME')
local ms = t[1] * 1000 + math.floor(t[2] / 1000)
redis.call('HSET', KEYS[1], 'progress', cjson.encode(told), 'tiles', tiles,
           'updated_at', string.format('%d', ms))
local last = redis.call('XREVRANGE', KEYS[2], '+', '-', 'COUNT', 1)[1]
if last and last[2][2] == 'progress'
    and ms - tonumber(string.match(last[1], '^%d+')) < tonumber(ARGV[7]) then
  return {'ok'}
end
told['tiles'] = cjson.decode(tiles)
redis.call('XADD', KEYS[2], 'MAXLEN', '~', ARGV[6], '*',
           'event', 'progress', 'data', cjson.encode(told))
redis.call('PUBLISH', ARGV[5], ARGV[1] .. ' running')
return {'ok'}
"""
